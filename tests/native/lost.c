/* SPDX-License-Identifier: Apache-2.0
 * A store's file is cut short before each shared access of each read and write in turn: what the call then says is what it
 * would have said, or CORRUPT; a write that says it is done was done before; no bell stays.  Also while another thread of the handle writes
 * on in the zeros, and while another thread closes the handle that the handler has in hand.  Tier: test. */
#define _GNU_SOURCE
#include <errno.h>
#include <semaphore.h>
#include <signal.h>
#include <stdbool.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "api/store.h"
#include "segment/failpoint.h"
#include "support/check.h"

enum { MOST_STEPS = 4000, ANSWER = 400 };
static char name[64], path[96];
static shmtf_store *h;
static shmtf_snapshot old_snapshot;
static _Thread_local shmtf_error e;
static _Thread_local bool is_reader;
static long left = -1; /* steps of the reader until the file is cut; negative: never */
static bool was_cut, beyond_commit;
static sem_t writer_waits, writer_may;

#ifdef SHMTF_STEPS
static _Thread_local bool is_writer;
static pthread_t writer; /* 0: none */

static void cut(const void *word) {
    was_cut = true;
    NEED(truncate(path, 0) == 0);
    if (!writer) return;
    (void)*(const volatile char *)word;
    sem_post(&writer_may);
    pthread_join(writer, NULL);
}
void shmtf_step(int kind, const void *word) {
    (void)kind;
    if (is_writer) {
        is_writer = false;
        sem_post(&writer_waits);
        sem_wait(&writer_may);
    }
    if (is_reader && left >= 0 && left-- == 0) cut(word);
}
void shmtf_failpoint(const char *at) {
    if (is_reader && left >= 0 && !strcmp(at, "half-unlocked")) beyond_commit = true;
}
#endif

static shmtf_status put(double x, int64_t stamp) {
    shmtf_transform t[2] = {{shmtf_by_name("a"), shmtf_by_name("b"), stamp, {x, 0, 0, 0, 0, 0, 1}, 0},
                            {shmtf_by_name("b"), shmtf_by_name("c"), 0, {5, 0, 0, 0, 0, 0, 1}, SHMTF_STATIC}};
    return shmtf_set_transforms(h, t, 2, NULL, NULL, &e);
}
static void make_store(void) {
    const shmtf_config c = {.max_frames = 8, .history = 6, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 2};
    NEED(shmtf_create(name, &c, 0600, &e) == SHMTF_OK && shmtf_attach(name, 0, "lost", 0, &h, &e) == SHMTF_OK);
    for (int64_t stamp = 10; stamp <= 30; stamp += 10) {
        NEED(put((double)stamp, stamp) == SHMTF_OK);
        if (stamp == 20) old_snapshot = shmtf_take_snapshot(h);
    }
}
static void end_store(void) {
    char at[64];
    bell_path(h->uuid, at);
    shmtf_close(h);
    NEED(shmtf_unlink(name, &e) == SHMTF_OK);
    CHECK(access(at, F_OK) != 0);
}

/* ---- calls, and what they say as text ---- */

static char *end_of(char *out) { return out + strlen(out); }
static shmtf_status transform_text(char *out, const shmtf_snapshot *snapshot, const int64_t *time) {
    shmtf_result r = {.edges = NULL};
    shmtf_status st = time ? shmtf_lookup_transform(h, snapshot, shmtf_by_name("a"), shmtf_by_name("c"), time, 0, &r, &e)
                           : shmtf_lookup_latest_transform(h, snapshot, shmtf_by_name("a"), shmtf_by_name("c"), 0, &r, &e);
    if (st == SHMTF_OK) snprintf(out, ANSWER, "%g %lld %u %llu", r.pose.x, (long long)r.stamp_ns, r.n_edges, (unsigned long long)r.version);
    else snprintf(out, ANSWER, "%s %s %lld", e.parent, e.child, (long long)e.newest_ns);
    return st;
}
static shmtf_status latest(char *out) { return transform_text(out, NULL, NULL); }
static shmtf_status latest_old(char *out) { return transform_text(out, &old_snapshot, NULL); }
static shmtf_status at_time(char *out) { return transform_text(out, NULL, &(int64_t){25}); }
static shmtf_status at_time_beyond(char *out) { return transform_text(out, NULL, &(int64_t){99}); }
static shmtf_status common(char *out) {
    int64_t t;
    int has;
    shmtf_status st = shmtf_latest_common_time(h, NULL, shmtf_by_name("a"), shmtf_by_name("c"), &t, &has, &e);
    snprintf(out, ANSWER, "%lld %d", (long long)t, has);
    return st;
}
static shmtf_status resolve(char *out) {
    shmtf_frame f = {0, 0};
    shmtf_status st = shmtf_resolve(h, NULL, "b", &f, &e);
    snprintf(out, ANSWER, "%u %u", f.id, f.gen);
    return st;
}
static shmtf_status frames(char *out) {
    shmtf_frame f[8];
    size_t n = 0;
    shmtf_status st = shmtf_frames(h, NULL, f, 8, &n, &e);
    for (size_t i = 0; st == SHMTF_OK && i < n; i++) snprintf(end_of(out), 32, "%u %u ", f[i].id, f[i].gen);
    return st;
}
static shmtf_status frame_name(char *out) {
    char text[SHMTF_NAME_SIZE];
    shmtf_status st = shmtf_frame_name(h, (shmtf_frame){1, 2}, text, &e);
    snprintf(out, ANSWER, "%s", text);
    return st;
}
static shmtf_status frame_info(char *out) {
    shmtf_frame_info i;
    shmtf_status st = shmtf_get_frame_info(h, NULL, shmtf_by_name("b"), &i, &e);
    snprintf(out, ANSWER, "%s %s %d %d %u %u %lld %llu", i.name, i.parent_name, i.is_static, i.is_root, i.n_records, i.capacity,
             (long long)i.newest_ns, (unsigned long long)i.n_written);
    return st;
}
static shmtf_status parent_text(char *out, const int64_t *time) {
    shmtf_frame f = {0, 0};
    shmtf_status st = shmtf_parent(h, NULL, shmtf_by_name("b"), time, &f, &e);
    if (st == SHMTF_OK) snprintf(out, ANSWER, "%u %u", f.id, f.gen);
    else snprintf(out, ANSWER, "%s %s %lld", e.parent, e.child, (long long)e.newest_ns);
    return st;
}
static shmtf_status parent(char *out) { return parent_text(out, NULL); }
static shmtf_status parent_beyond(char *out) { return parent_text(out, &(int64_t){99}); }
static shmtf_status records(char *out) {
    shmtf_record r[8];
    size_t n = 0;
    shmtf_status st = shmtf_records(h, NULL, shmtf_by_name("b"), r, 8, &n, &e);
    for (size_t i = 0; i < n; i++) snprintf(end_of(out), 32, "%lld %g ", (long long)r[i].stamp_ns, r[i].pose.x);
    return st;
}
static shmtf_status changes(char *out) {
    uint64_t version;
    shmtf_status st = shmtf_wait_for_change(h, &(shmtf_ref){"b", {0, 0}}, 1, 1, 0, &version, &e);
    snprintf(out, ANSWER, "%llu", (unsigned long long)version);
    return st;
}
static shmtf_status write_more(char *out) { return (void)out, put(40, 40); }
static shmtf_status write_birth(char *out) {
    shmtf_transform t = {shmtf_by_name("c"), shmtf_by_name("d"), 50, {1, 0, 0, 0, 0, 0, 1}, 0};
    return (void)out, shmtf_set_transforms(h, &t, 1, NULL, NULL, &e);
}
static shmtf_status write_remove(char *out) { return (void)out, shmtf_remove_frame(h, shmtf_by_name("c"), NULL, &e); }
static shmtf_status write_clear(char *out) { return (void)out, shmtf_clear(h, 0, NULL, &e); }
static shmtf_status write_declare(char *out) { return (void)out, shmtf_declare_frame(h, "d", 3, NULL, &e); }

typedef shmtf_status (*call)(char *out);
static const call reads[] = {latest, latest_old, at_time, at_time_beyond, common,        resolve, frames,
                             frame_name, frame_info, parent, parent_beyond, records, changes};
static const call writes[] = {write_more, write_birth, write_remove, write_clear, write_declare};

/* The call with the file cut before its k-th step; false: it has fewer. */
static bool cut_before(call function, long k, shmtf_status *st, char answer[ANSWER]) {
    memset(answer, 0, ANSWER);
    was_cut = beyond_commit = false;
    left = k;
    is_reader = true;
    *st = function(answer);
    is_reader = false;
    left = -1;
    return was_cut;
}

static void reads_say_so(void) {
    for (size_t i = 0; i < sizeof reads / sizeof *reads; i++) {
        char want[ANSWER], got[ANSWER];
        shmtf_status expected, st;
        bool more = true;
        for (long k = -1; more && k < MOST_STEPS; k++) {
            make_store();
            more = cut_before(reads[i], k, k < 0 ? &expected : &st, k < 0 ? want : got) || k < 0;
            if (more && k >= 0 && st != SHMTF_CORRUPT && !CHECK(st == expected && !strcmp(got, want)))
                fprintf(stderr, "    read %zu, step %ld: %s '%s', not '%s'\n", i, k, shmtf_status_name(st), got, want);
            end_store();
        }
        CHECK(!more);
    }
}

static void writes_say_so(void) {
    for (size_t i = 0; i < sizeof writes / sizeof *writes; i++) {
        char ignored[ANSWER];
        shmtf_status st;
        bool more = true;
        for (long k = 0; more && k < MOST_STEPS; k++) {
            make_store();
            more = cut_before(writes[i], k, &st, ignored);
            EQUAL(more && !beyond_commit ? st : SHMTF_CORRUPT, SHMTF_CORRUPT);
            CHECK(st == SHMTF_OK || st == SHMTF_CORRUPT);
            end_store();
        }
        CHECK(!more);
    }
}

/* ---- another thread writes on ---- */

#ifdef SHMTF_STEPS
static void *write_on(void *unused) {
    is_writer = true;
    shmtf_status st = put(777, 777);
    is_writer = false;
    EQUAL(st, was_cut ? SHMTF_CORRUPT : SHMTF_OK);
    return unused;
}
static void what_was_never_written(void) {
    for (size_t i = 0; i < sizeof reads / sizeof *reads; i++) {
        char want[ANSWER], got[ANSWER];
        shmtf_status expected, st;
        bool more = true;
        make_store();
        cut_before(reads[i], -1, &expected, want);
        end_store();
        for (long k = 0; more && k < MOST_STEPS; k++) {
            make_store();
            NEED(!pthread_create(&writer, NULL, write_on, NULL));
            sem_wait(&writer_waits);
            more = cut_before(reads[i], k, &st, got);
            if (!more) sem_post(&writer_may), pthread_join(writer, NULL);
            writer = 0;
            if (more && st != SHMTF_CORRUPT && !CHECK(st == expected && !strcmp(got, want)))
                fprintf(stderr, "    read %zu, step %ld: %s '%s', not '%s'\n", i, k, shmtf_status_name(st), got, want);
            end_store();
        }
        CHECK(!more);
    }
}
#endif

/* ---- another thread closes ---- */

static volatile char *place, *foreign;
static sem_t close_now, closed;

void *__real_mmap(void *at, size_t size, int protection, int flags, int fd, off_t offset);
void *__wrap_mmap(void *at, size_t size, int protection, int flags, int fd, off_t offset);
void *__wrap_mmap(void *at, size_t size, int protection, int flags, int fd, off_t offset) {
    if (place && at == (void *)(uintptr_t)place && (flags & MAP_ANONYMOUS) && !(flags & MAP_FIXED_NOREPLACE)) {
        struct timespec until;
        place = NULL;
        sem_post(&close_now);
        clock_gettime(CLOCK_REALTIME, &until);
        until.tv_sec++;
        while (sem_timedwait(&closed, &until) && errno == EINTR) continue;
    }
    return __real_mmap(at, size, protection, flags, fd, offset);
}
static void *close_and_reuse(void *at) {
    sem_wait(&close_now);
    shmtf_close(h);
    foreign = mmap(at, 4096, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1, 0);
    NEED(foreign == at);
    *foreign = 7;
    sem_post(&closed);
    return NULL;
}
/* A signal without an address, as from a handler above ours, makes the handler look at all mappings. */
static void closed_in_the_handler(void) {
    pthread_t closer;
    make_store();
    NEED(truncate(path, 0) == 0 && !pthread_create(&closer, NULL, close_and_reuse, h->base));
    place = h->base;
    raise(SIGBUS);
    pthread_join(closer, NULL);
    EQUAL(*foreign, 7);
    NEED(shmtf_unlink(name, &e) == SHMTF_OK);
}

int main(void) {
    snprintf(name, sizeof name, "shmtf-lost-%d", (int)getpid());
    snprintf(path, sizeof path, "/dev/shm/%s", name);
    NEED(shmtf_guard_truncation(&e) == SHMTF_OK);
    sem_init(&writer_waits, 0, 0);
    sem_init(&writer_may, 0, 0);
    sem_init(&close_now, 0, 0);
    sem_init(&closed, 0, 0);
    reads_say_so();
    writes_say_so();
#ifdef SHMTF_STEPS
    what_was_never_written();
#endif
    closed_in_the_handler();
    return check_result("lost");
}
