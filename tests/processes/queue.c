/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: queue STORE ROUNDS ATTEMPTS PRIORITY [dead]
 *
 * A writer stops itself while it holds a frame.  An ordinary writer comes and has tried in vain ATTEMPTS times, 9 at most; then
 * another comes, with priority if PRIORITY is 1, and has announced that it waits (or, without PRIORITY, has tried twice).
 * Then the holder goes on.  Which of the two commits first?  Prints how often the second did.  With `dead` the second is
 * killed while it waits: the others must get through all the same, and its wish must be gone.  Tier: test.
 */
#define _GNU_SOURCE
#include "../soak/crowd.h"
#include "api/store.h"
#include "segment/failpoint.h"

enum { HOLDER, FIRST, SECOND, CREW };
enum { POLITE = 8 }; /* attempts after which an ordinary writer announces that it waits, too, and stays where it is */

typedef struct {
    atomic_long round[CREW], finished[CREW], begun[CREW];
    atomic_long version[CREW];
} board;

static board *all;
static const char *store_name;
static int me = -1, armed, priority;
static long rounds;

void shmtf_failpoint(const char *name) {
    if (me < 0) return;
    if (!strcmp(name, "begun")) atomic_fetch_add(&all->begun[me], 1);
    if (armed && !strcmp(name, "staged-all")) armed = 0, raise(SIGSTOP);
}

static void member(int k) {
    const shmtf_write_options options = {.timeout_ns = -1, .priority = k == SECOND && priority};
    shmtf_store *h = join(store_name, 0);
    me = k;
    for (long i = atomic_load(&all->finished[k]) + 1; i <= rounds; i++) {
        shmtf_transform t = crowd_edge("root", "frame", now_ns(), k);
        shmtf_error e;
        uint64_t version;
        while (atomic_load(&all->round[k]) < i) usleep(50);
        armed = k == HOLDER;
        if (shmtf_set_transforms(h, &t, 1, &options, &version, &e)) stop("write", &e);
        atomic_store(&all->version[k], (long)version);
        atomic_store(&all->begun[k], 0);
        atomic_store(&all->finished[k], i);
    }
    shmtf_close(h);
}

static void until_stopped(pid_t pid) {
    int status;
    if (waitpid(pid, &status, WUNTRACED) != pid || !WIFSTOPPED(status)) stop("the holder did not stop", NULL);
}

/* One round.  Did the second come first? */
static int play(const shmtf_word *want, pid_t pids[CREW], long i, long attempts, int dead) {
    atomic_store(&all->round[HOLDER], i);
    until_stopped(pids[HOLDER]);
    atomic_store(&all->round[FIRST], i);
    while (atomic_load(&all->begun[FIRST]) < attempts || (attempts > POLITE && !load_acquire(want))) usleep(50);
    atomic_store(&all->round[SECOND], i);
    if (priority || dead)
        while (!(priority ? wish_first(load_acquire(want)) : load_acquire(want) != 0)) usleep(50);
    else
        while (atomic_load(&all->begun[SECOND]) < 2) usleep(50);
    if (dead) {
        kill(pids[SECOND], SIGKILL);
        if (!ended_well(pids[SECOND], SIGKILL)) stop("the second ended by itself", NULL);
        atomic_store(&all->begun[SECOND], 0);
        atomic_store(&all->finished[SECOND], i);
    }
    kill(pids[HOLDER], SIGCONT);
    for (int k = 0; k < CREW; k++)
        while (atomic_load(&all->finished[k]) < i) usleep(50);
    if (dead) pids[SECOND] = spawn(member, SECOND);
    return !dead && all->version[SECOND] < all->version[FIRST];
}

int main(int argc, char **argv) {
    shmtf_error e;
    shmtf_config c = {.max_frames = 8, .history = 8, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 8};
    pid_t pids[CREW];
    if (argc < 5) return 2;
    store_name = argv[1];
    rounds = atol(argv[2]);
    priority = atoi(argv[4]);
    int bad = 0, dead = argc > 5 && !strcmp(argv[5], "dead");
    long before = 0;
    all = shared_memory(sizeof *all);
    if (shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    shmtf_store *h = join(store_name, 0);
    shmtf_frame frame;
    shmtf_transform t = crowd_edge("root", "frame", 0, 0);
    if (shmtf_set_transforms(h, &t, 1, NULL, NULL, &e) || shmtf_resolve(h, NULL, "frame", &frame, &e)) stop("write", &e);
    const shmtf_word *want = &h->s.frames[frame.id].want;
    for (int k = 0; k < CREW; k++) pids[k] = spawn(member, k);
    for (long i = 1; i <= rounds; i++) before += play(want, pids, i, atol(argv[3]), dead);
    for (int k = 0; k < CREW; k++) bad += !ended_well(pids[k], 0);
    t.stamp_ns = now_ns();
    if (shmtf_set_transforms(h, &t, 1, NULL, NULL, &e)) stop("the last write", &e);
    if (load_acquire(want)) bad++, fprintf(stderr, "a wish is left\n");
    shmtf_close(h);
    printf("%ld of %ld rounds: the second came first; %d failed\n", before, rounds, bad);
    return bad != 0;
}
