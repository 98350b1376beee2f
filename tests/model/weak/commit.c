/* SPDX-License-Identifier: Apache-2.0
 *
 * E2, E4: a transaction of two frames beside a reader of both, who sees it in both or in none; a commit before S is in S.
 *
 *   -DAPART       a second writer commits another frame on top, so that the first one's state is settled by it
 *   -DOPPOSITE    a second writer of the same two frames in opposite order (long)
 *   -DCRASH_AT=k  kills the first writer before its k-th store; its slot is adopted then: no lock is left, nothing committed
 *                 is lost, and a new transaction gets through
 */
#define MORTAL
#include "scenario.h"

static uint64_t seen;

static void *first(void *unused) {
    (void)unused;
    mortal = true;
    write_frames(0, 1, 2, 1, false);
    return NULL;
}

static void *second(void *unused) {
    (void)unused;
#ifdef APART
    write_frames(1, 3, 0, 2, false);
#else
    write_frames(1, 2, 1, 2, false);
#endif
    return NULL;
}

static void *reader(void *unused) {
    (void)unused;
    uint64_t snapshot = snapshot_now(), va, vb;
    uint64_t a = newest(snapshot, 1, &va), b = newest(snapshot, 2, &vb);
    assert(a == b && va == vb);
#ifdef APART
    uint64_t vc, c = newest(snapshot, 3, &vc);
    assert((a != 0) + (c != 0) == (int)commit_version(snapshot));
#else
    assert(va == commit_version(snapshot));
#endif
    seen = a;
    return NULL;
}

/* All are done or dead. */
static void aftermath(void) {
    uint64_t va, vb, snapshot = snapshot_now(), a = newest(snapshot, 1, &va);
    assert(newest(snapshot, 2, &vb) == a && va == vb && (a || !seen));
    recover_adopt(&s, 0);
    for (uint32_t id = 1; id <= FRAMES; id++) assert(!lock_owned(load_acquire(&frames[id].lock)));
    assert(newest(snapshot, 1, &va) == a && newest(snapshot, 2, &vb) == a);
    assert(write_frames(2, 1, 2, 9, false) == TXN_OK);
    snapshot = snapshot_now();
    assert(newest(snapshot, 1, &va) == 9 && newest(snapshot, 2, &vb) == 9 && va == vb);
}

int main(void) {
    pthread_t t[3];
    make_segment();
    pthread_create(&t[0], NULL, first, NULL);
    pthread_create(&t[2], NULL, reader, NULL);
#if defined APART || defined OPPOSITE
    pthread_create(&t[1], NULL, second, NULL);
    pthread_join(t[1], NULL);
#endif
    pthread_join(t[0], NULL);
    pthread_join(t[2], NULL);
    aftermath();
    return 0;
}
