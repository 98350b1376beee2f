/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: pingpong STORE ROUNDS [KILL_EVERY]
 *
 * Two processes hand a stamp to each other: each waits for the other's frame and then writes its own.  A wake-up that got
 * lost would show as a wait that ends without a change, or as a long one: both are counted, and the first is an error.
 * With KILL_EVERY, a third process that waits for the same frames is killed in every so many rounds, and replaced.
 * Tier: test with 20,000 rounds; on demand with a million.
 */
#define _GNU_SOURCE
#include "crowd.h"

enum { LONG_NS = 90000000 }; /* a sleeper that nobody wakes looks by itself after 100 ms */

typedef struct {
    atomic_long turn[2], slow, waits;
    atomic_int over;
} board;

static board *all;
static const char *store_name;
static long rounds;
static const char *const names[2] = {"ping", "pong"};

static void wait_for(shmtf_store *h, const char *name, uint64_t *since) {
    const shmtf_ref frame = shmtf_by_name(name);
    shmtf_error e;
    int64_t at = now_ns();
    if (shmtf_wait_for_change(h, &frame, 1, *since, 60000000000, since, &e)) stop("wait", &e);
    if (now_ns() - at > LONG_NS) atomic_fetch_add(&all->slow, 1);
}

/* Player 0 writes round i, player 1 sees it and writes it too, player 0 sees that. */
static void play(int k) {
    shmtf_store *h = join(store_name, 0);
    uint64_t since = 0;
    int64_t other = 0;
    shmtf_counters c;
    for (long i = 1; i <= rounds; i++) {
        for (int half = 0; half < 2; half++) {
            shmtf_error e;
            if (half == k) {
                shmtf_transform t = crowd_edge("root", names[k], i, (double)i);
                if (shmtf_set_transforms(h, &t, 1, NULL, NULL, &e)) stop("write", &e);
                atomic_store(&all->turn[k], i);
            }
            while (half != k && other < i) {
                shmtf_result r = {.edges = NULL};
                wait_for(h, names[1 - k], &since);
                if (shmtf_lookup_latest_transform(h, NULL, shmtf_by_name("root"), shmtf_by_name(names[1 - k]), 0, &r, &e)) stop("read", &e);
                if (r.version < since) stop("a change that is not there", NULL);
                other = r.stamp_ns;
            }
        }
    }
    shmtf_get_counters(h, &c);
    atomic_fetch_add(&all->waits, (long)c.waits);
    shmtf_close(h);
}

static void disturb(int k) {
    (void)k;
    shmtf_store *h = join(store_name, SHMTF_READONLY);
    const shmtf_ref frames[2] = {shmtf_by_name(names[0]), shmtf_by_name(names[1])};
    for (uint64_t since = 0;;) {
        shmtf_error e;
        if (shmtf_wait_for_change(h, frames, 2, since, 1000000000, &since, &e) && e.status != SHMTF_TIMEOUT) stop("wait", &e);
    }
}

int main(int argc, char **argv) {
    shmtf_error e;
    shmtf_config c = {.max_frames = 8, .history = 8, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 8};
    if (argc < 3) return 2;
    store_name = argv[1];
    rounds = atol(argv[2]);
    long every = argc > 3 ? atol(argv[3]) : 0, kills = 0;
    int bad = 0;
    all = shared_memory(sizeof *all);
    if (shmtf_create(store_name, &c, 0600, &e)) stop("create", &e);
    shmtf_store *h = join(store_name, 0);
    shmtf_transform t[2] = {crowd_edge("root", names[0], 0, 0), crowd_edge("root", names[1], 0, 0)};
    if (shmtf_set_transforms(h, t, 2, NULL, NULL, &e)) stop("write", &e);
    shmtf_close(h);
    int64_t began = now_ns();
    pid_t players[2] = {spawn(play, 0), spawn(play, 1)}, third = every ? spawn(disturb, 2) : 0;
    for (long next = every; every && next < rounds; next += every) {
        while (atomic_load(&all->turn[0]) < next && !waitpid(players[0], &bad, WNOHANG) && !waitpid(players[1], &bad, WNOHANG)) usleep(200);
        if (atomic_load(&all->turn[0]) < next) return fprintf(stderr, "a player is gone\n"), 1;
        kill(third, SIGKILL);
        if (!ended_well(third, SIGKILL)) return fprintf(stderr, "the third ended by itself\n"), 1;
        third = spawn(disturb, 2);
        kills++;
    }
    bad = !ended_well(players[0], 0);
    bad += !ended_well(players[1], 0);
    if (third) kill(third, SIGKILL);
    if (third) bad += !ended_well(third, SIGKILL);
    double seconds = (double)(now_ns() - began) * 1e-9;
    printf("%ld rounds, %.2f us a round, %ld sleeps, %ld waits of more than 90 ms, %ld waiters killed, %d failed\n", rounds,
           seconds * 1e6 / (double)rounds, (long)all->waits, (long)all->slow, kills, bad);
    return bad != 0;
}
