/* SPDX-License-Identifier: Apache-2.0
 *
 * E3: a slot of a ring is filled again while its record is read: the old record whole, or nothing.
 */
#include "scenario.h"

static void *writer_of_slot(void *unused) {
    (void)unused;
    shmtf_pose pose = {.x = 2};
    record_write(&inlines[1].head[0], &inlines[1].body[0], lock_tag(lock_make(0, 2)), 2, 2, 2, 2, &pose);
    store_relaxed(&inlines[1].head[0].tag, 2);
    return NULL;
}

static void *reader(void *unused) {
    (void)unused;
    ring_view v = {.f = &frames[1], .ring = {inlines[1].head, inlines[1].body, NULL, SHMTF_INLINE_LOG2}};
    ring_record r;
    if (record_read(&v, 0, commit_make(0, 1), &r) == RECORD_OK)
        assert(r.version == 1 && r.stamp == 1 && r.arrival == 1 && r.info == 1 && r.parent == 1 && r.pose.x == 1);
    return NULL;
}

int main(void) {
    pthread_t t[2];
    make_segment();
    shmtf_pose pose = {.x = 1};
    record_write(&inlines[1].head[0], &inlines[1].body[0], lock_tag(lock_make(0, 1)), 1, 1, 1, 1, &pose);
    store_relaxed(&inlines[1].head[0].tag, 1);
    pthread_create(&t[0], NULL, writer_of_slot, NULL);
    pthread_create(&t[1], NULL, reader, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    return 0;
}
