/* SPDX-License-Identifier: Apache-2.0
 *
 * The rules that every call on a corrupted store must keep, whatever the segment says:
 *
 *   bounds    every access to shared memory, counted by the step hook, lies inside this store's mapping or its bell, and no
 *             store touches the header
 *   reads     store nothing in the segment
 *   steps     the accesses of one call stay below a bound that depends on the capacities only: an endless walk is found
 *             without a clock.  A clock watches too, for walks that touch nothing.
 *   answers   are those that shmtf.h documents for the call, with texts that end
 */
#include "fuzz.h"

#include <execinfo.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "segment/failpoint.h"

enum { WATCHDOG_S = 60, BELL_PAGE = 4096 };

static bool has_watchdog; /* libFuzzer has its own */
uint64_t watch_seed, watch_input;

static struct {
    const unsigned char *base;
    uint64_t size;
    const shmtf_store *store;
    const char *call;
    call_kind kind;
    uint64_t steps, bound;
    unsigned char *disturb_base;
    shmtf_geometry disturb_geo;
    uint32_t period;
    bool inside; /* of the hook itself */
} now;

void watch_failed(const char *what) {
    now.base = NULL;
    fprintf(stderr, "%s: %s in %s after %llu accesses; --seed %llu --only %llu\n", fuzz_target, what,
            now.call ? now.call : "no call", (unsigned long long)now.steps, (unsigned long long)watch_seed,
            (unsigned long long)watch_input);
    void *frames[32];
    backtrace_symbols_fd(frames, backtrace(frames, 32), STDERR_FILENO);
    abort();
}

static void on_alarm(int number) {
    (void)number;
    watch_failed("no end: the watchdog's time is over");
}

static void say_where(void) {
    fprintf(stderr, "%s: died in %s; --seed %llu --only %llu\n", fuzz_target, now.call ? now.call : "no call",
            (unsigned long long)watch_seed, (unsigned long long)watch_input);
}

void __sanitizer_set_death_callback(void (*callback)(void)) __attribute__((weak));

static void on_crash(int number) {
    say_where();
    signal(number, SIG_DFL);
    raise(number);
}

void watch_init(void) {
    void *warm[1];
    backtrace(warm, 1); /* it allocates the first time */
    has_watchdog = true;
    signal(SIGALRM, on_alarm);
    if (__sanitizer_set_death_callback) {
        __sanitizer_set_death_callback(say_where);
        return;
    }
    const int crashes[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL};
    for (size_t i = 0; i < sizeof crashes / sizeof *crashes; i++) signal(crashes[i], on_crash);
}

/* A call may be tried at 1000 commits.  A try may look 16 times at the records of the largest ring, at every hint of the
 * name table with the name it leads to, and walk twice, once by hints and once measured, over all frames on both sides. */
static uint64_t bound_of(const shmtf_geometry *g) {
    enum { COMMITS = 1000, VIEWS = 16, A_RECORD = 8, A_HINT = 24, A_FRAME = 64 };
    uint64_t largest = 1 << SHMTF_INLINE_LOG2;
    while (shmtf_ring_bytes(0, sizeof(shmtf_record_body)) * largest * 2 <= g->n_chunks * SHMTF_CHUNK_BYTES) largest *= 2;
    return COMMITS * (VIEWS * largest * A_RECORD + g->n_buckets * SHMTF_BUCKET_HINTS * A_HINT + g->max_frames * A_FRAME);
}

void watch_store(const shmtf_store *h) {
    now.store = h;
    now.base = h->base;
    now.size = h->s.geo.size_bytes;
    now.bound = bound_of(&h->s.geo);
    if (now.bound > tally.bound) tally.bound = now.bound;
}

void watch_nothing(void) { now.base = NULL, now.store = NULL, now.call = NULL; }

void watch_call(const char *name, call_kind kind) {
    now.call = name;
    now.kind = kind;
    now.steps = 0;
    if (has_watchdog) alarm(WATCHDOG_S);
}

static const uint64_t always = 1ull << SHMTF_OK | 1ull << SHMTF_INVALID_ARGUMENT | 1ull << SHMTF_CORRUPT | 1ull << SHMTF_LOOKUP;
static const uint64_t by_read = 1ull << SHMTF_CONNECTIVITY | 1ull << SHMTF_BACKWARD | 1ull << SHMTF_FORWARD | 1ull << SHMTF_NO_DATA |
                                1ull << SHMTF_SNAPSHOT_EXPIRED | 1ull << SHMTF_TIMEOUT;
static const uint64_t by_write = 1ull << SHMTF_CYCLE | 1ull << SHMTF_OLD_DATA | 1ull << SHMTF_FULL | 1ull << SHMTF_READ_ONLY |
                                 1ull << SHMTF_BUSY | 1ull << SHMTF_CONFLICT;

static void check_texts(const shmtf_error *e) {
    char line[64];
    bool ended = memchr(e->parent, 0, sizeof e->parent) && memchr(e->child, 0, sizeof e->child) && memchr(e->holder, 0, sizeof e->holder);
    if (!ended) watch_failed("a text without an end");
    shmtf_error_message(e, line, sizeof line);
    if (!memchr(line, 0, sizeof line)) watch_failed("a message without an end");
}

void watch_answer(shmtf_status st, const shmtf_error *error) {
    uint64_t may = always | (now.kind == CALL_READ ? by_read : by_write);
    if ((unsigned)st >= 32 || !(may & 1ull << st)) {
        fprintf(stderr, "%s ", shmtf_status_name(st));
        watch_failed("an answer that is not documented");
    }
    if (error && error->status != st) watch_failed("an error that says something else than the answer");
    if (error && st != SHMTF_OK) check_texts(error);
    tally.answers[st]++;
    if (now.steps > tally.most_steps) tally.most_steps = now.steps, tally.most_in = now.call;
    now.call = NULL;
}

void watch_disturb(unsigned char *base, const shmtf_geometry *geo, uint32_t period) {
    now.disturb_base = base;
    now.disturb_geo = *geo;
    now.period = period;
}

static void disturb(const unsigned char *word) {
    unsigned char *same = NULL;
    if (!one_in(now.period)) return;
    if (one_in(2) && word >= now.base + SHMTF_PAGE && word < now.base + now.size) /* what was just looked at, or is about to be */
        same = now.disturb_base + ((uint64_t)(word - now.base) & ~7ull);
    mutate_word(now.disturb_base, &now.disturb_geo, same);
    tally.disturbed++;
}

void shmtf_step(int kind, const void *word) {
    if (!now.base || !now.call || now.inside) return;
    const unsigned char *at = word, *bell_at = (const unsigned char *)now.store->bell_map;
    now.inside = true;
    bool in_bell = bell_at && at >= bell_at && at < bell_at + BELL_PAGE;
    if (!in_bell && (at < now.base || at + 4 > now.base + now.size)) watch_failed("an access outside of the store");
    if (!in_bell && kind == SHMTF_STEP_STORE && at < now.base + SHMTF_PAGE) watch_failed("a store into the header");
    if (!in_bell && kind == SHMTF_STEP_STORE && now.kind == CALL_READ) watch_failed("a read that stores");
    if (++now.steps > now.bound) watch_failed("no end: more accesses than the capacities explain");
    if (now.period && !in_bell) disturb(at);
    now.inside = false;
}

void shmtf_failpoint(const char *name) { images_failpoint(name); }
