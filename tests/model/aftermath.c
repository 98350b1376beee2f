/* SPDX-License-Identifier: Apache-2.0
 *
 * What must hold of the segment when everybody is done or dead, and recovered.
 */
#include "xsim.h"

/* Beside the lock stands what the ring says. */
static void check_copy(uint32_t id, uint64_t lock, uint64_t head) {
    shmtf_frame_words_t *f = &xs.s.frames[id];
    unsigned sel = lock_sel(lock);
    ring_ref r = {NULL, NULL, NULL, 0};
    ring_record newest;
    if (!head_count(head)) return xsim_expect(atomic_load(&f->newest_tag[sel]), 0, "the copy of no record");
    if (!ring_bind(&xs.s, id, head, &r)) xsim_fail("the ring of a frame", id, 0);
    uint64_t slot = ring_slot(&r, head, head_count(head));
    ring_copy(&r.heads[slot], &r.bodies[slot], &newest);
    xsim_expect(atomic_load(&f->newest_tag[sel]), atomic_load(&r.heads[slot].tag), "the version in the copy of the newest record");
    xsim_expect(atomic_load(&f->newest_stamp[sel]), (uint64_t)newest.stamp, "the stamp in the copy of the newest record");
    xsim_expect(atomic_load(&f->newest_edge[sel]), edge_make(newest.parent, info_kind(newest.info), info_flags(newest.info)), "the edge in the copy");
    xsim_expect(search_base(atomic_load(&f->newest_search[sel])), newest.info & 0xffffff, "the base in the copy of the newest record");
    xsim_expect((uint64_t)(int64_t)load_double(&f->newest[sel].pose[0]), (uint64_t)(int64_t)newest.pose.x, "the value in the copy of the newest record");
}

void xsim_check_ring(uint32_t id) {
    uint64_t lock = atomic_load(&xs.s.frames[id].lock), head = atomic_load(&xs.s.frames[id].head[lock_sel(lock)]);
    ring_ref r = {NULL, NULL, NULL, 0};
    if (lock_owned(lock)) xsim_fail("a lock is left", id, 0);
    check_copy(id, lock, head);
    if (!(head & HEAD_BIG)) return;
    if (!ring_bind(&xs.s, id, head, &r)) xsim_fail("the ring of a frame", id, 0);
    uint64_t seen = 0, count = head_count(head);
    for (uint64_t p = 1; p <= ring_mask(&r) + 1; p++) seen |= 1ull << ring_slot(&r, head, p);
    xsim_expect(seen, (1ull << (ring_mask(&r) + 1)) - 1, "the index as a permutation");
    ring_record newest, rec;
    if (!count) return;
    uint64_t slot = ring_slot(&r, head, count), live = shmtf_ring_live(r.log2);
    ring_copy(&r.heads[slot], &r.bodies[slot], &newest);
    uint64_t first = info_base(newest.info, count), window = count > live ? count - live + 1 : 1;
    for (uint64_t p = count; p >= first && p >= window; p--) {
        slot = ring_slot(&r, head, p);
        ring_copy(&r.heads[slot], &r.bodies[slot], &rec);
        if (lock_owned(atomic_load(&r.heads[slot].tag))) xsim_fail("a record in force without a version", id, p);
        if (rec.stamp > newest.stamp) xsim_fail("a ring that is not sorted", id, p);
        newest = rec;
    }
}

/* No two frames have one piece of the arena. */
void xsim_check_rings_apart(void) {
    for (uint32_t id = 1; id <= xs.s.geo.max_frames; id++) {
        uint64_t one = atomic_load(&xs.s.frames[id].ring);
        if (one && !ring_word_valid(&xs.s, one)) xsim_fail("an impossible ring", id, one);
        for (uint32_t k = 1; one && k < id; k++) {
            uint64_t other = atomic_load(&xs.s.frames[k].ring);
            bool apart = ring_word_first(one) + ring_word_chunks(one) <= ring_word_first(other) ||
                         ring_word_first(other) + ring_word_chunks(other) <= ring_word_first(one);
            if (other && !apart) xsim_fail("one piece of the arena is of two rings", id, k);
        }
    }
}
