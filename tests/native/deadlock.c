/* SPDX-License-Identifier: Apache-2.0
 *
 * Two writers of priority, each with two births in one batch, and two free frames: each holds one and needs the
 * other's.  One of them must give way; a watchdog ends the test if none does.  Only a library with failpoints brings
 * them into that position.
 */
#include <pthread.h>
#include <sched.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "segment/failpoint.h"
#include "shmtf.h"
#include "support/check.h"

static char name[64];
static atomic_int done;
static _Thread_local int me = -1;

#ifdef SHMTF_STEPS
enum { MEETINGS = 4 };
static atomic_int holding[2];
static _Thread_local int births, meetings;

void shmtf_failpoint(const char *at) {
    if (me < 0) return;
    if (!strcmp(at, "begun")) {
        births = 0;
        atomic_store(&holding[me], 0);
    }
    if (strcmp(at, "floor-raised") || births++ || ++meetings > MEETINGS) return;
    atomic_store(&holding[me], 1); /* a free frame is ours: until the other has one too */
    for (long turns = 0; turns < 100000 && !atomic_load(&holding[1 - me]) && !atomic_load(&done); turns++) sched_yield();
}
#endif

typedef struct {
    int k;
    shmtf_status result;
} worker;

static void *work(void *argument) {
    worker *w = argument;
    const shmtf_write_options options = {.timeout_ns = -1, .priority = 1};
    static _Thread_local char names[2][16];
    shmtf_transform t[2];
    shmtf_store *h;
    shmtf_error e;
    w->result = shmtf_attach(name, 0, NULL, 0, &h, &e);
    if (w->result != SHMTF_OK) return NULL;
    me = w->k;
    for (int i = 0; i < 2; i++) {
        snprintf(names[i], sizeof names[i], "w%d-%d", w->k, i);
        t[i] = (shmtf_transform){shmtf_by_name("root"), shmtf_by_name(names[i]), 0, {0, 0, 0, 0, 0, 0, 1}, SHMTF_STATIC};
    }
    w->result = shmtf_set_transforms(h, t, 2, &options, NULL, &e);
    atomic_store(&done, 1);
    shmtf_close(h);
    return NULL;
}

int main(void) {
    const shmtf_config c = {.max_frames = 4, .history = 4, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 4};
    shmtf_transform t = {shmtf_by_name("root"), shmtf_by_name("x"), 0, {0, 0, 0, 0, 0, 0, 1}, SHMTF_STATIC};
    worker w[2] = {{.k = 0}, {.k = 1}};
    shmtf_error e;
    shmtf_store *h;
    snprintf(name, sizeof name, "shmtf-test-deadlock-%d", (int)getpid());
    NEED(shmtf_create(name, &c, 0600, &e) == SHMTF_OK && shmtf_attach(name, 0, NULL, 0, &h, &e) == SHMTF_OK);
    NEED(shmtf_set_transforms(h, &t, 1, NULL, NULL, &e) == SHMTF_OK);
    alarm(60);
    pthread_t thread[2];
    for (int k = 0; k < 2; k++) NEED(pthread_create(&thread[k], NULL, work, &w[k]) == 0);
    for (int k = 0; k < 2; k++) pthread_join(thread[k], NULL);
    CHECK((w[0].result == SHMTF_OK) != (w[1].result == SHMTF_OK));
    CHECK(w[0].result == SHMTF_FULL || w[1].result == SHMTF_FULL);
    shmtf_close(h);
    EQUAL(shmtf_unlink(name, &e), SHMTF_OK);
    return check_result("deadlock");
}
