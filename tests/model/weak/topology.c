/* SPDX-License-Identifier: Apache-2.0
 *
 * E6: two transactions change the shape of frames 1 and 2, each having seen that the other's has not: one of them must be
 * refused.  The first writer begins its next transaction at once, so that only the topology word tells of its commit.
 */
#include "scenario.h"

static bool done[2];

static bool reshape(unsigned slot, uint32_t mine, uint32_t other) {
    txn *x = &of_slot[slot].x;
    uint64_t version;
    if (txn_begin(x) != TXN_OK) return false;
    if (newest(x->snapshot, other, &version) || !put(x, mine, mine)) return txn_abort(x), false;
    x->reshapes = true;
    return txn_commit(x, &version) == TXN_OK;
}

static void *first(void *unused) {
    (void)unused;
    done[0] = reshape(0, 1, 2);
    txn_begin(&of_slot[0].x);
    return NULL;
}

static void *second(void *unused) {
    (void)unused;
    done[1] = reshape(1, 2, 1);
    return NULL;
}

int main(void) {
    pthread_t t[2];
    make_segment();
    pthread_create(&t[0], NULL, first, NULL);
    pthread_create(&t[1], NULL, second, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    assert(!(done[0] && done[1]));
    return 0;
}
