/* SPDX-License-Identifier: Apache-2.0
 * One frame's ring against a sorted list: random writes in every order, read back at the present and at older commits. */
#include "core/ring.h"

#include "support/check.h"
#include "support/world.h"

enum { MOST = 64, COMMITS = 400 };

typedef struct {
    int64_t stamp;
    double value;
    uint64_t version;
} entry;

typedef struct {
    record_kind kind; /* KIND_ROOT: nothing to read */
    int n;
    entry e[MOST];
} model;

static model at_version[COMMITS + 8];
static uint64_t seed = 0x9e3779b97f4a7c15ull;
static world w;
static writer wr;
static unsigned log2_now;
static int64_t cache;
static long n_old, n_read, n_dropped, n_repeat, n_refused;

static int64_t horizon(const model *m) { return cache < 0 || !m->n ? INT64_MIN : m->e[m->n - 1].stamp - cache; }

/* What one dynamic record does to a model: 1 written, 0 dropped or repeated. */
static int model_put(model *m, entry e) {
    if (m->kind != KIND_DYNAMIC) m->kind = KIND_DYNAMIC, m->n = 0;
    int at = m->n, live = (int)shmtf_ring_live(log2_now);
    while (at > 0 && m->e[at - 1].stamp > e.stamp) at--;
    if (m->n == live && at == 0) return n_dropped++, 0;
    if (at > 0 && m->e[at - 1].stamp == e.stamp && m->e[at - 1].value == e.value) return n_repeat++, 0;
    memmove(&m->e[at + 1], &m->e[at], (size_t)(m->n - at) * sizeof e);
    m->e[at] = e;
    if (++m->n > live) memmove(&m->e[0], &m->e[1], (size_t)(--m->n) * sizeof e);
    return 1;
}

static void check_index(uint32_t id) {
    uint64_t lock = atomic_load(&w.s.frames[id].lock), head = atomic_load(&w.s.frames[id].head[lock_sel(lock)]);
    ring_ref r;
    if (!(head & HEAD_BIG)) return;
    NEED(ring_bind(&w.s, id, head, &r));
    bool seen[1 << 8] = {false};
    for (uint64_t p = 1; p <= ring_mask(&r) + 1; p++) {
        uint64_t slot = ring_slot(&r, head, p);
        CHECK(slot <= ring_mask(&r) && !seen[slot]);
        seen[slot] = true;
    }
}

static void check_around(uint32_t id, uint64_t snapshot, const model *m, int64_t t, bool present) {
    ring_around_result a;
    ring_status st = ring_around(&w.s, id, snapshot, t, &a);
    n_read++;
    if (st == RING_OLD && !present) return (void)n_old++;
    EQUAL(st, RING_OK);
    if (st != RING_OK || m->kind == KIND_ROOT) return;
    EQUAL(info_kind(a.newest.info), m->kind);
    CHECK(a.newest.pose.x == m->e[m->n - 1].value && a.newest.version == m->e[m->n - 1].version);
    if (m->kind != KIND_DYNAMIC) return;
    int before = -1, after = -1;
    for (int i = 0; i < m->n && m->e[i].stamp <= t; i++) before = i;
    for (int i = before + 1; i < m->n && (after < 0 || m->e[i].stamp == m->e[after].stamp); i++) after = i;
    bool has = before >= 0 && m->e[before].stamp >= horizon(m);
    EQUAL(a.has_before, has);
    if (has && a.has_before) CHECK(a.before.stamp == m->e[before].stamp && a.before.pose.x == m->e[before].value);
    bool wants_after = t < m->e[m->n - 1].stamp && !(has && m->e[before].stamp == t);
    EQUAL(a.has_after, wants_after);
    if (wants_after && a.has_after) CHECK(a.after.stamp == m->e[after].stamp && a.after.pose.x == m->e[after].value);
    int oldest = 0;
    while (m->e[oldest].stamp < horizon(m)) oldest++;
    if (has && t <= m->e[m->n - 1].stamp) return;
    EQUAL(a.alone, m->n == 1);
    if (present) EQUAL(a.oldest_stamp, m->e[oldest].stamp); /* at an older commit: of what has not been overwritten since */
    else CHECK(a.oldest_stamp >= m->e[oldest].stamp);
}

static void check_list(uint32_t id, uint64_t snapshot, const model *m, bool present) {
    ring_record out[MOST];
    size_t n;
    ring_status st = ring_list(&w.s, id, snapshot, out, MOST, &n);
    if (st == RING_OLD && !present) return;
    EQUAL(st, RING_OK);
    if (st != RING_OK || m->kind != KIND_DYNAMIC) return;
    size_t k = 0;
    for (int i = m->n - 1; i >= 0 && m->e[i].stamp >= horizon(m); i--) {
        if (i + 1 < m->n && m->e[i].stamp == m->e[i + 1].stamp) continue;
        if (k == n && !present) return; /* the oldest were overwritten since */
        if (!CHECK(k < n)) return;
        CHECK(out[k].stamp == m->e[i].stamp && out[k].pose.x == m->e[i].value && out[k].version == m->e[i].version);
        k++;
    }
    EQUAL(k, n);
}

static void check_reads(uint32_t id, uint64_t now) {
    uint64_t word = now_of(&w);
    const model *m = &at_version[now];
    check_index(id);
    check_list(id, word, m, true);
    for (int i = 0; i < m->n; i++)
        for (int64_t d = -1; d <= 1; d++) check_around(id, word, m, m->e[i].stamp + d, true);
    check_around(id, word, m, INT64_MIN, true);
    check_around(id, word, m, INT64_MAX, true);
    for (uint64_t back = 1; back < 12 && back < now; back++) {
        uint64_t old = commit_make(0, now - back);
        const model *o = &at_version[now - back];
        if (o->kind == KIND_NONE) break;
        check_list(id, old, o, false);
        ring_record r;
        ring_status st = ring_latest(&w.s, id, old, &r);
        CHECK(st == RING_OK || st == RING_OLD);
        if (st == RING_OK && o->kind != KIND_ROOT)
            CHECK(r.pose.x == o->e[o->n - 1].value && r.version == o->e[o->n - 1].version && info_kind(r.info) == o->kind);
        for (int k = 0; k < 4; k++) {
            int64_t t = o->n ? o->e[check_random(&seed) % (uint64_t)o->n].stamp + (int64_t)(check_random(&seed) % 3) - 1 : 0;
            check_around(id, old, o, t, false);
        }
    }
}

/* A batch of dynamic records, and what it should do. */
static void write_dynamic(model *m, int64_t *clock, double *value) {
    shmtf_transform batch[8];
    size_t n = 1 + check_random(&seed) % shmtf_ring_spare(log2_now);
    model next = *m;
    int written = 0;
    bool refused = false;
    uint64_t version = commit_version(now_of(&w)) + 1;
    for (size_t i = 0; i < n; i++) {
        int64_t stamp = *clock;
        switch (check_random(&seed) % 6) {
        case 0: stamp -= (int64_t)(check_random(&seed) % 40); break;
        case 1: stamp -= (int64_t)(check_random(&seed) % 400); break;
        case 2: break;
        default: stamp = *clock += 1 + (int64_t)(check_random(&seed) % 12); break;
        }
        double x = check_random(&seed) % 8 ? (*value += 1) : *value;
        batch[i] = edge_at("p", "c", stamp, x);
        if (next.kind == KIND_DYNAMIC && next.n && stamp < horizon(&next)) refused = true;
        if (!refused) written += model_put(&next, (entry){stamp, x, version});
    }
    stage_status st = write_all(&wr, batch, n);
    EQUAL(st, refused ? STAGE_OLD_DATA : STAGE_OK);
    n_refused += refused;
    if (!refused && written) *m = next;
}

static void write_static(model *m, double *value) {
    uint64_t version = commit_version(now_of(&w)) + 1;
    bool again = m->kind == KIND_STATIC && check_random(&seed) % 2;
    double x = again ? m->e[0].value : (*value += 1);
    EQUAL(write_one(&wr, static_edge("p", "c", x)), STAGE_OK);
    if (!again) *m = (model){.kind = KIND_STATIC, .n = 1, .e = {{0, x, version}}};
}

/* Positions and flips as they are after a long life; the newest record stays where it is. */
static void age(uint32_t id, uint64_t count, uint64_t flips) {
    shmtf_frame_words_t *f = &w.s.frames[id];
    uint64_t sel = lock_sel(atomic_load(&f->lock)), head = atomic_load(&f->head[sel]);
    atomic_store(&f->head[sel], head_make(head_count(head) + count, flips, 0));
}

static void run(unsigned log2, int64_t cache_ns, uint64_t count, uint64_t flips) {
    log2_now = log2;
    cache = cache_ns;
    world_make(&w, 8, shmtf_ring_live(log2), cache_ns, 0, 4);
    EQUAL(w.s.geo.default_log2, log2);
    writer_make(&wr, &w, 0);
    memset(at_version, 0, sizeof at_version);
    NEED(declare_named(&wr, "c", log2) == STAGE_OK && declare_named(&wr, "p", log2) == STAGE_OK);
    uint32_t id = id_of(&w, "c");
    age(id, count, flips);
    model m = {.kind = KIND_ROOT};
    int64_t clock = 1000;
    double value = 0;
    at_version[1].kind = KIND_NONE;
    at_version[2] = m;
    for (int n = 0; n < COMMITS; n++) {
        if (check_random(&seed) % 24 == 0) write_static(&m, &value);
        else write_dynamic(&m, &clock, &value);
        uint64_t now = commit_version(now_of(&w));
        NEED(now < COMMITS + 8);
        at_version[now] = m;
        check_reads(id, now);
        if (check_failures > 20) break;
    }
    writer_free(&wr);
    world_free(&w);
}

/* Garbage where a frame's ring stands: sizes that no ring has are refused, whatever count the head claims. */
static void check_impossible_sizes(void) {
    world_make(&w, 8, 14, -1, 1 << 20, 4);
    shmtf_frame_words_t *f = &w.s.frames[3];
    for (unsigned log2 = 0; log2 < 32; log2++) {
        ring_ref r;
        ring_record out;
        atomic_store(&f->ring, RING_USED | log2);
        atomic_store(&f->head[0], HEAD_BIG | HEAD_COUNT_MASK);
        bool valid = ring_bind(&w.s, 3, HEAD_BIG, &r);
        CHECK(valid ? log2 >= 3 && log2 <= SHMTF_MAX_RING_LOG2 : true);
        if (!valid) EQUAL(ring_latest(&w.s, 3, commit_make(0, 5), &out), RING_CORRUPT);
    }
    world_free(&w);
}

/* A late stamp at every displacement in a full ring, one ring for each. */
static void check_displacements(void) {
    log2_now = 4;
    cache = -1;
    int live = (int)shmtf_ring_live(log2_now);
    for (int back = 0; back <= live + 1; back++) {
        world_make(&w, 8, (uint64_t)live, -1, 0, 4);
        writer_make(&wr, &w, 0);
        model m = {.kind = KIND_ROOT};
        for (int i = 0; i < live + 5; i++) {
            NEED(write_one(&wr, edge_at("p", "c", 10 * i, i)) == STAGE_OK);
            model_put(&m, (entry){10 * i, i, commit_version(now_of(&w))});
        }
        int64_t stamp = 10 * (live + 4) + 5 - 10 * back;
        uint64_t before = now_of(&w);
        NEED(write_one(&wr, edge_at("p", "c", stamp, 99)) == STAGE_OK);
        model_put(&m, (entry){stamp, 99, commit_version(before) + 1});
        EQUAL(now_of(&w) != before, back < live);
        EQUAL(wr.x.late_dropped, back >= live);
        uint32_t id = id_of(&w, "c");
        check_index(id);
        for (int i = 0; i < m.n; i++)
            for (int64_t d = -1; d <= 1; d++) check_around(id, now_of(&w), &m, m.e[i].stamp + d, true);
        writer_free(&wr);
        world_free(&w);
    }
}

int main(void) {
    check_impossible_sizes();
    check_displacements();
    static const uint64_t counts[] = {0, (1 << 24) - 64, (1ull << 32) - 64, 1ull << 40};
    for (unsigned log2 = 3; log2 <= 6; log2++)
        for (size_t c = 0; c < 4; c++) {
            run(log2, -1, counts[c], c % 2 ? HEAD_FLIP_MASK - 3 : 0);
            run(log2, 60, counts[c], c % 2 ? HEAD_FLIP_MASK - 3 : 0);
        }
    printf("ring: %ld reads, %ld of older commits too old, %ld dropped, %ld repeats, %ld refused\n", n_read, n_old, n_dropped, n_repeat,
           n_refused);
    CHECK(n_dropped && n_repeat && n_refused && n_old < n_read / 4);
    return check_result("ring");
}
