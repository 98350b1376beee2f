/* SPDX-License-Identifier: Apache-2.0
 * Writers with priority are stopped while they wait, each for another frame of one batch: each of them holds the batch up
 * once, and not the next batches.  One that is not stopped after all says its wish again.  Tier: test. */
#include <string.h>
#include <unistd.h>

#include "api/store.h"
#include "support/check.h"

enum { FRAMES = 3 };
static char name[64];
static shmtf_error e;
static const char *const frame[FRAMES] = {"a", "b", "c"};

static shmtf_store *join(void) {
    shmtf_store *h = NULL;
    NEED(shmtf_attach(name, 0, "wishes", 0, &h, &e) == SHMTF_OK);
    return h;
}
/* How often it gave way. */
static uint64_t put_all(shmtf_store *h, int64_t stamp) {
    shmtf_transform t[FRAMES];
    shmtf_counters before, after;
    const shmtf_write_options wait = {.timeout_ns = -1};
    for (int i = 0; i < FRAMES; i++) t[i] = (shmtf_transform){shmtf_by_name("root"), shmtf_by_name(frame[i]), stamp, {0, 0, 0, 0, 0, 0, 1}, 0};
    shmtf_get_counters(h, &before);
    EQUAL(shmtf_set_transforms(h, t, FRAMES, &wait, NULL, &e), SHMTF_OK);
    shmtf_get_counters(h, &after);
    return after.aborts - before.aborts;
}
/* A handle's writer announces that it waits, and does not go on. */
static shmtf_word *wish(shmtf_store *h, const char *which) {
    shmtf_frame f;
    write_context *c;
    NEED(shmtf_resolve(h, NULL, which, &f, &e) == SHMTF_OK && store_take(h, &c, &e) == SHMTF_OK);
    NEED(txn_begin(&c->x) == TXN_OK);
    c->x.priority = true;
    txn_want(&c->x, f.id);
    store_give(c);
    NEED(lock_tag(load_acquire(&h->s.frames[f.id].want)) == c->x.own);
    return &h->s.frames[f.id].want;
}

int main(void) {
    const shmtf_config config = {.max_frames = 16, .history = 6, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 8};
    snprintf(name, sizeof name, "shmtf-wishes-%d", (int)getpid());
    NEED(shmtf_create(name, &config, 0600, &e) == SHMTF_OK);
    shmtf_store *h = join(), *stopped[FRAMES];
    shmtf_word *want[FRAMES];
    int64_t stamp = 1;
    EQUAL(put_all(h, stamp++), 0);
    for (int n = 1; n <= FRAMES; n++) {
        for (int i = 0; i < n; i++) want[i] = wish(stopped[i] = join(), frame[i]);
        EQUAL(put_all(h, stamp++), n);
        for (int k = 0; k < 3; k++) EQUAL(put_all(h, stamp++), 0);
        for (int i = 0; i < n; i++) EQUAL(load_acquire(want[i]), 0);
        for (int i = 0; i < n; i++) want[i] = wish(stopped[i], frame[i]);
        EQUAL(put_all(h, stamp++), n);
        for (int i = 0; i < n; i++) shmtf_close(stopped[i]);
    }
    shmtf_close(h);
    shmtf_unlink(name, NULL);
    return check_result("wishes");
}
