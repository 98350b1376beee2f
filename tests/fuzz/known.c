/* SPDX-License-Identifier: Apache-2.0
 *
 * Single words that once led a call astray, each by itself.  Tier: test.
 */
#include "fuzz.h"

#include "../native/support/check.h"

const char *const fuzz_target = "fuzz_known";

static bench *whole_store(shmtf_geometry *geo) {
    unsigned n;
    const uint8_t input[8] = {0};
    const image *all = images_all(&n);
    take_from(input, sizeof input);
    for (unsigned i = 0; i < n; i++)
        if (!strcmp(all[i].what, "turning")) {
            image_geometry(all[i].world, geo);
            return bench_load(&all[i], false);
        }
    abort();
}

/* A reach beyond the table made a miss "look again": a thousand times, at each of a thousand commits. */
static void impossible_reach(void) {
    shmtf_geometry geo;
    shmtf_error e;
    bench *b = whole_store(&geo);
    shmtf_store *h = bench_attach(b->fd, 0);
    NEED(h);
    store_relaxed(&h->s.global->reach, geo.n_buckets);
    tally.most_steps = 0;
    watch_call("shmtf_lookup_transform", CALL_READ);
    shmtf_status st = shmtf_lookup_transform(h, NULL, shmtf_by_name("nobody"), shmtf_by_name("n0"), NULL, 0, NULL, &e);
    watch_answer(st, &e);
    EQUAL(st, SHMTF_LOOKUP);
    CHECK(tally.most_steps < 10 * geo.n_buckets * SHMTF_BUCKET_HINTS);
    watch_nothing();
    shmtf_close(h);
}

/* A wish that names a live transaction, but is no lock word, was given way to for ever. */
static void wish_of_nobody(void) {
    shmtf_geometry geo;
    shmtf_error e;
    bench *b = whole_store(&geo);
    shmtf_store *h = bench_attach(b->fd, 0);
    shmtf_transform item = {shmtf_by_name("n0"), shmtf_by_name("n1"), 5000, {0, 0, 0, 0, 0, 0, 1}, 0};
    NEED(h);
    NEED(shmtf_set_transforms(h, &item, 1, NULL, NULL, &e) == SHMTF_OK); /* now it has a slot, and n1 a handle */
    uint64_t own = lock_make(0, load_relaxed(&h->s.writers[0].txn) + 1); /* of the transaction to come */
    store_relaxed(&h->s.frames[item.child.frame.id].want, lock_released(own));
    item.stamp_ns++;
    watch_call("shmtf_set_transforms", CALL_WRITE);
    shmtf_status st = shmtf_set_transforms(h, &item, 1, NULL, NULL, &e);
    watch_answer(st, &e);
    EQUAL(st, SHMTF_OK);
    watch_nothing();
    shmtf_close(h);
}

int main(void) {
    watch_init();
    impossible_reach();
    wish_of_nobody();
    return check_result("fuzz_known");
}
