/* SPDX-License-Identifier: Apache-2.0
 *
 * Who does what at once.  Frame f is the root; records are in rings of 8, of which 6 can be read.
 */
#include "xsim.h"

static void set_edges(int slot, const char *parent, const char *children, int64_t stamp, double x, int tries) {
    shmtf_transform t[4];
    char names[4][2];
    size_t n = strlen(children);
    for (size_t i = 0; i < n; i++) {
        names[i][0] = children[i];
        names[i][1] = 0;
        t[i] = edge_at(parent, names[i], stamp, x + (double)i);
    }
    xsim_set(slot, t, n, tries);
}

static void set_static(int slot, const char *parent, const char *child, double x) {
    shmtf_transform t = static_edge(parent, child, x);
    xsim_set(slot, &t, 1, 2);
}

/* ---- what was there before ------------------------------------------------------------------------------------- */

static void full_rings(void) { /* so that every write evicts */
    for (int i = 1; i <= 7; i++) set_edges(XSIM_SETUP, "f", "ab", 10 * i, i, 1);
}
static void short_rings(void) {
    for (int i = 1; i <= 4; i++) set_edges(XSIM_SETUP, "f", "ab", 10 * i, i, 1);
}
static void late_rings(void) { /* indexed already */
    full_rings();
    set_edges(XSIM_SETUP, "f", "ab", 33, 100, 1);
}
/* The last commit does not change the shape: otherwise its state would tell the topology, and its word never be read. */
static void one_record(void) {
    set_edges(XSIM_SETUP, "f", "ab", 9, 1, 1);
    set_edges(XSIM_SETUP, "f", "ab", 10, 1, 1);
}
static void only_root(void) {
    set_static(XSIM_SETUP, "f", "e", 1);
    set_static(XSIM_SETUP, "f", "e", 2);
}
static void nearly_full(void) { /* of 4 frames: one is free, and was something before */
    only_root();
    set_edges(XSIM_SETUP, "f", "ab", 10, 1, 1);
    xsim_remove(XSIM_SETUP, shmtf_by_name("b"), 1);
    set_edges(XSIM_SETUP, "f", "a", 11, 1, 1);
}
static uint64_t old_snapshot; /* of before the setup's last commits */
static void born_and_removed(void) { /* b, in the old snapshot alone */
    only_root();
    set_edges(XSIM_SETUP, "f", "ab", 10, 1, 1);
    old_snapshot = xsim_snapshot();
    xsim_remove(XSIM_SETUP, shmtf_by_name("b"), 1);
    set_edges(XSIM_SETUP, "f", "a", 11, 1, 1);
}
static void with_a_past(void) {
    short_rings();
    old_snapshot = xsim_snapshot();
    set_edges(XSIM_SETUP, "f", "ab", 45, 50, 1);
}
static void room_for_one(void) { /* ring: e has most of the arena */
    only_root();
    xsim_declare(XSIM_SETUP, "e", 5);
    set_static(XSIM_SETUP, "f", "e", 3);
}
static void no_room(void) { /* a has the last ring */
    room_for_one();
    for (int i = 1; i <= 3; i++) set_edges(XSIM_SETUP, "f", "a", 10 * i, i, 1);
}
static void a_ring_left(void) { /* the last one, by a, which was removed */
    only_root();
    xsim_declare(XSIM_SETUP, "e", 4);
    xsim_declare(XSIM_SETUP, "f", 3);
    set_edges(XSIM_SETUP, "f", "a", 10, 1, 1);
    xsim_remove(XSIM_SETUP, shmtf_by_name("a"), 1);
    set_static(XSIM_SETUP, "f", "e", 3);
}
static void fixed(void) {
    set_static(XSIM_SETUP, "f", "a", 3);
    set_edges(XSIM_SETUP, "f", "b", 10, 1, 1);
    set_edges(XSIM_SETUP, "f", "b", 11, 1, 1);
}
static void chain(void) {
    set_edges(XSIM_SETUP, "f", "ab", 10, 1, 1);
    set_edges(XSIM_SETUP, "a", "c", 10, 4, 1);
    set_edges(XSIM_SETUP, "a", "c", 11, 4, 1);
}

/* ---- threads ----------------------------------------------------------------------------------------------------- */

static void write_ab(int i) { set_edges(i, "f", "ab", 100, 1000 + i, 2); }
static void write_ba(int i) { set_edges(i, "f", "ba", 200, 2000 + i, 2); }
static void write_a(int i) { set_edges(i, "f", "a", 150 + i, 3000 + i, 2); }
static void write_b(int i) { set_edges(i, "f", "b", 150 + i, 4000 + i, 2); }
static void write_a_thrice(int i) {
    for (int k = 0; k < 3; k++) set_edges(i, "f", "a", 160 + 10 * k, 5000 + k, 2);
}
static void write_late(int i) {
    set_edges(i, "f", "ba", 45, 6000, 2);
    set_edges(i, "f", "a", 46, 6100, 2);
}
static void write_two_late(int i) { /* in one transaction */
    shmtf_transform t[3] = {edge_at("f", "a", 48, 6200), edge_at("f", "a", 36, 6300), edge_at("f", "b", 300, 6400)};
    xsim_set(i, t, 3, 2);
}
static void turn(int i) { /* the whole ring, and its order index twice */
    for (int k = 0; k < 8; k++) set_edges(i, "f", "a", k == 2 || k == 5 ? 95 + 10 * k : 100 + 10 * k, 8000 + k, 2);
}
static void read_ab(int i) {
    (void)i;
    xsim_read_latest(xsim_snapshot(), "ab");
}
static void read_twice(int i) {
    read_ab(i);
    read_ab(i);
}
static void read_around(int i) {
    (void)i;
    xsim_read_around(xsim_snapshot(), "a", 47);
}
static void read_before_all(int i) {
    (void)i;
    xsim_read_around(xsim_snapshot(), "a", 25);
}
static void adopt(int i) {
    if (xsim_adopt(0)) set_edges(0, "f", "ba", 300, 7000 + i, 2);
}
static void adopt_births(int i) {
    if (xsim_adopt(0)) set_edges(0, "f", "c", 300, 7100 + i, 2);
}
static void birth_c(int i) { set_edges(i, "f", "c", 20 + i, 100 * (i + 1), 3); }
static void birth_d(int i) { set_edges(i, "f", "d", 20 + i, 100 * (i + 1), 3); }
static void birth_of_both(int i) {
    shmtf_transform t = edge_at("d", "c", 20 + i, 100 * (i + 1));
    xsim_set(i, &t, 1, 3);
}
static void read_c(int i) {
    (void)i;
    xsim_read_names(xsim_snapshot(), "c");
}
static void read_cd(int i) {
    (void)i;
    xsim_read_names(xsim_snapshot(), "dc");
}
static void remove_a(int i) { xsim_remove(i, shmtf_by_name("a"), 2); }
static void remove_then_c(int i) {
    remove_a(i);
    birth_c(i);
}
static void set_below_a(int i) { set_edges(i, "a", "b", 50, 500, 3); }
static void read_a_and_names(int i) {
    (void)i;
    uint64_t s = xsim_snapshot();
    xsim_read_latest(s, "a");
    xsim_read_names(s, "a");
}
static void read_names_ac(int i) {
    (void)i;
    xsim_read_names(xsim_snapshot(), "ca");
}
static void read_names_bc(int i) {
    (void)i;
    xsim_read_names(xsim_snapshot(), "bc");
}
static void clear_dynamic(int i) { xsim_clear(i, true, 2); }
static void clear_both(int i) {
    xsim_clear(i, false, 2);
    xsim_clear(i, true, 2);
}
static void a_below_b(int i) { set_edges(i, "b", "a", 50, 800, 3); }
static void b_below_a(int i) { set_edges(i, "a", "b", 50, 900, 3); }
static void read_path(int i) {
    (void)i;
    xsim_read_path(xsim_snapshot(), "a", "b");
}
static void read_path_c(int i) {
    (void)i;
    xsim_read_path(xsim_snapshot(), "f", "c");
}
static void static_a(int i) { set_static(i, "f", "a", 700 + i); }
static void static_b(int i) { set_static(i, "f", "b", 750 + i); }
static void dynamic_a(int i) { set_edges(i, "f", "a", 5, 770 + i, 2); }

static void birth_b(int i) { set_edges(i, "f", "b", 20 + i, 100 * (i + 1), 3); }
static void read_b_now_and_then(int i) {
    (void)i;
    xsim_read_names(old_snapshot, "b");
    xsim_read_names(xsim_snapshot(), "b");
}
static void remove_then_a(int i) {
    remove_a(i);
    set_edges(i, "f", "a", 60, 650, 3);
}
static void read_then(int i) {
    (void)i;
    xsim_read_latest(old_snapshot, "ab");
    xsim_read_around(old_snapshot, "a", 33);
}
static void clear_then_late(int i) {
    clear_dynamic(i);
    set_edges(i, "f", "a", 50, 660, 2);
    set_edges(i, "f", "a", 42, 670, 2);
}
static void flip_a(int i) {
    static_a(i);
    dynamic_a(i);
}
static void wish_ab(int i) { /* waits for its locks, and announces it */
    xsim_manners(i, WAITS);
    write_ab(i);
}
static void wish_b(int i) {
    xsim_manners(i, WAITS);
    set_edges(i, "f", "b", 210, 690, 2);
}
static void wish_ab_first(int i) { /* with priority */
    xsim_manners(i, WAITS_FIRST);
    write_ab(i);
}
static void polite_a(int i) {
    xsim_manners(i, POLITE);
    write_a(i);
}
static void one_got_it(uint64_t snapshot) { /* two that want the last ring must not both go without */
    shmtf_frame f;
    bool none = find_frame(&xs, snapshot, "c", &f) != RING_OK && find_frame(&xs, snapshot, "d", &f) != RING_OK;
    if (none && !sched_is_dead(0) && !sched_is_dead(1)) xsim_fail("a ring that nobody got", 0, 1);
}
static void first_got_through(uint64_t snapshot) { /* who waits does */
    (void)snapshot;
    if (!sched_is_dead(0)) xsim_expect(ghost_wrote(0), true, "whether the one who waited wrote");
}
static void both_got_through(uint64_t snapshot) {
    first_got_through(snapshot);
    if (!sched_is_dead(1)) xsim_expect(ghost_wrote(1), true, "whether the other one who waited wrote");
}

#pragma GCC diagnostic ignored "-Wmissing-field-initializers" /* few have an end of their own */
const scenario scenarios[] = {
    {"opposite orders", 3, full_rings, 3, {write_ab, write_ba, read_ab}, 4, "ab"},
    {"helping the last committer", 3, full_rings, 3, {write_a, write_b, read_ab}, 4, "ab"},
    {"helping, read twice", 3, short_rings, 3, {write_ab, write_b, read_twice}, 4, "ab"},
    {"three writers of one frame", 3, full_rings, 3, {write_a, write_a, write_a_thrice}, 0, "ab"},
    {"late stamps", 3, full_rings, 3, {write_ab, write_late, read_around}, 4, "ab"},
    {"late stamps, indexed", 3, late_rings, 3, {write_two_late, write_late, read_around}, 4, "ab"},
    {"before all that is kept", 3, full_rings, 3, {write_a, write_late, read_before_all}, 4, "ab"},
    {"adoption", 3, full_rings, 3, {write_ab, adopt, read_ab}, 4, "ab"},
    {"adoption beside a helper", 3, full_rings, 4, {write_ab, adopt, write_ba, read_ab}, 8, "ab"},
    {"two births of one name", 6, only_root, 3, {birth_c, birth_c, read_c}, 4, "e"},
    {"births with their parent", 6, only_root, 3, {birth_of_both, birth_d, read_cd}, 4, "e"},
    {"adoption of a birth", 6, only_root, 3, {birth_c, adopt_births, read_c}, 4, "e"},
    {"two births, one free frame", 4, nearly_full, 3, {birth_c, birth_d, read_cd}, 4, "ae"},
    {"removal and another name", 3, one_record, 3, {remove_then_c, write_a, read_a_and_names}, 4, "b"},
    {"the freed frame taken", 3, one_record, 3, {remove_a, birth_c, read_names_ac}, 4, "b"},
    {"removal of a parent", 4, chain, 3, {remove_a, set_below_a, read_path}, 4, "b"},
    {"removal and birth as parent", 4, chain, 3, {remove_then_c, set_below_a, read_names_bc}, 4, "b"},
    {"clear against writes", 3, one_record, 3, {clear_dynamic, write_ab, read_ab}, 4, "ab"},
    {"clears against a static", 3, fixed, 3, {clear_both, static_b, read_ab}, 4, "ab"},
    {"a below b, b below a", 3, one_record, 3, {a_below_b, b_below_a, read_path}, 4, "ab"},
    {"reparenting under a path", 4, chain, 3, {a_below_b, write_ba, read_path_c}, 4, "ab"},
    {"a ring turns under a reader", 3, full_rings, 2, {turn, read_ab}, 2, "ab"},
    {"an index turns under a reader", 3, late_rings, 2, {turn, read_around}, 2, "ab"},
    {"a ring turns below a time", 3, late_rings, 2, {turn, read_before_all}, 2, "ab"},
    {"static and back", 3, full_rings, 3, {static_a, dynamic_a, read_around}, 4, "ab"},
    {"static records only", 3, fixed, 3, {static_a, static_a, read_twice}, 4, "ab"},
    {"a name born again", 5, born_and_removed, 3, {birth_b, birth_b, read_b_now_and_then}, 4, "ae"},
    {"removed and born again", 4, with_a_past, 3, {remove_then_a, write_a, read_a_and_names}, 4, "b"},
    {"an old snapshot", 3, with_a_past, 3, {write_ab, write_late, read_then}, 4, "ab"},
    {"clear and late stamps", 3, full_rings, 3, {clear_dynamic, write_late, read_around}, 4, "ab"},
    {"segments at an old snapshot", 3, with_a_past, 3, {clear_then_late, flip_a, read_then}, 4, "ab"},
    {"clears against flips", 3, full_rings, 3, {clear_both, flip_a, read_around}, 4, "ab"},
    {"two births, one ring", 5, room_for_one, 3, {birth_c, birth_d, read_cd}, 4, "e", true, one_got_it},
    {"two births, a ring left", 4, a_ring_left, 3, {birth_c, birth_d, read_cd}, 4, "e", true, one_got_it},
    {"a ring changes hands", 5, no_room, 3, {remove_then_c, write_a, read_a_and_names}, 4, "e", true, NULL},
    {"a wish", 3, short_rings, 3, {wish_ab, polite_a, read_ab}, 4, "ab", false, first_got_through},
    {"a wish with priority", 3, short_rings, 3, {wish_ab_first, wish_b, polite_a}, 0, "ab", false, first_got_through},
    {"two wishes", 3, short_rings, 2, {wish_ab, wish_b}, 0, "ab", false, both_got_through},
};
const int n_scenarios = sizeof scenarios / sizeof *scenarios;
