/* SPDX-License-Identifier: Apache-2.0
 *
 * One lock around everything: a robust, process-shared mutex, which is what tf2 does between the threads of one process
 * (the thesis' `old`).  Records, rings, name hashing, checks of what is written, the walk and the arithmetic are those of
 * the store; what is left out is what a lock makes unnecessary: tags, versions, snapshots, owners.
 *
 *   giant         the lock is taken for each frame of an update, as setTransform does: a read may come in between
 *   giant-atomic  the lock is taken once per update, which is what shmtf promises and tf2 does not
 *
 * Both are at their best here: names are hashed before the lock is taken, and parents never change, so a frame's depth
 * is a number.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/names.h"
#include "core/pose.h"
#include "protocol.h"

enum { PERIOD_NS = 10000000 };

typedef struct {
    uint32_t parent, depth;
    uint64_t count; /* records written */
    uint64_t hash, word[SHMTF_NAME_WORDS];
} giant_frame;

typedef struct {
    pthread_mutex_t mutex;
    uint64_t size_bytes;
    uint32_t max_frames, n_bound, n_buckets, log2;
} giant_header;

struct bench_client {
    giant_header *h;
    uint32_t *buckets; /* frame number + 1, open addressing; never shrinks */
    giant_frame *frames;
    unsigned char *rings;
    size_t ring_bytes;
    bench_shape shape;
    char (*names)[BENCH_NAME_SIZE];
    name_key *keys;
    shmtf_pose poses[BENCH_POSES];
    bool atomic;
};

static size_t round_up(size_t n) { return (n + 4095) / 4096 * 4096; }
static shmtf_record_head *heads_of(const bench_client *c, uint32_t i) {
    return (shmtf_record_head *)(void *)(c->rings + i * c->ring_bytes);
}
static shmtf_record_body *bodies_of(const bench_client *c, uint32_t i) {
    return (shmtf_record_body *)(void *)(c->rings + i * c->ring_bytes + (sizeof(shmtf_record_head) << c->h->log2));
}

static size_t bind_parts(bench_client *c, unsigned char *base, uint32_t max_frames, uint32_t n_buckets, unsigned log2) {
    size_t at = round_up(sizeof(giant_header));
    c->h = (giant_header *)(void *)base;
    c->buckets = (uint32_t *)(void *)(base + at);
    at += round_up(n_buckets * sizeof *c->buckets);
    c->frames = (giant_frame *)(void *)(base + at);
    at += round_up(max_frames * sizeof *c->frames);
    c->rings = base + at;
    c->ring_bytes = shmtf_ring_bytes(log2, sizeof(shmtf_record_body));
    return at + max_frames * c->ring_bytes;
}

/* A holder that died leaves whole records: the count is raised after them. */
static void take(giant_header *h) {
    if (pthread_mutex_lock(&h->mutex) == EOWNERDEAD) pthread_mutex_consistent(&h->mutex);
}
static void give(giant_header *h) { pthread_mutex_unlock(&h->mutex); }

/* The frame with this name; made if `make`.  UINT32_MAX: there is none, or no room. */
static uint32_t find_locked(bench_client *c, const name_key *key, bool make) {
    for (uint32_t i = 0; i < c->h->n_buckets; i++) {
        uint32_t *bucket = &c->buckets[(key->hash + i) & (c->h->n_buckets - 1)];
        if (!*bucket) {
            uint32_t id = c->h->n_bound;
            if (!make || id >= c->h->max_frames) return UINT32_MAX;
            c->h->n_bound = id + 1;
            c->frames[id].hash = key->hash;
            c->frames[id].parent = UINT32_MAX;
            memcpy(c->frames[id].word, key->word, key->n_words * 8);
            *bucket = id + 1;
            return id;
        }
        const giant_frame *f = &c->frames[*bucket - 1];
        if (f->hash == key->hash && !memcmp(f->word, key->word, key->n_words * 8)) return *bucket - 1;
    }
    return UINT32_MAX;
}

static bool make_key(const bench_client *c, uint32_t i, name_key *key) {
    return !c->shape.by_name || !names_key(key, c->names[i]);
}
/* Names come and go, so the table is searched under the lock; only the hashing is done before. */
static uint32_t resolve_locked(bench_client *c, uint32_t i, const name_key *key) {
    return c->shape.by_name ? find_locked(c, key, false) : i;
}

static void load_pose(const shmtf_record_body *b, shmtf_pose *p) {
    *p = (shmtf_pose){load_double(&b->pose[0]), load_double(&b->pose[1]), load_double(&b->pose[2]), load_double(&b->pose[3]),
                      load_double(&b->pose[4]), load_double(&b->pose[5]), load_double(&b->pose[6])};
}

static void store_record(shmtf_record_head *h, shmtf_record_body *b, int64_t stamp, int64_t arrival, const shmtf_pose *p,
                         uint32_t parent) {
    uint64_t words[SHMTF_POSE_WORDS];
    memcpy(words, p, sizeof words);
    store_relaxed(&h->stamp, (uint64_t)stamp);
    store_relaxed(&h->arrival, (uint64_t)arrival);
    store_relaxed(&h->info, 0);
    for (int i = 0; i < SHMTF_POSE_WORDS; i++) store_relaxed(&b->pose[i], words[i]);
    store_relaxed(&b->parent, parent);
}

/* Append, or move what is newer up by one. */
static void put_locked(bench_client *c, uint32_t i, int64_t stamp, int64_t arrival, const shmtf_pose *p) {
    giant_frame *f = &c->frames[i];
    shmtf_record_head *heads = heads_of(c, i);
    shmtf_record_body *bodies = bodies_of(c, i);
    uint64_t mask = (1ull << c->h->log2) - 1, at = f->count;
    while (at && f->count - at < mask && (int64_t)load_relaxed(&heads[(at - 1) & mask].stamp) > stamp) {
        memcpy(&heads[at & mask], &heads[(at - 1) & mask], sizeof *heads);
        memcpy(&bodies[at & mask], &bodies[(at - 1) & mask], sizeof *bodies);
        at--;
    }
    store_record(&heads[at & mask], &bodies[at & mask], stamp, arrival, p, f->parent);
    f->count++;
}

static bool fill(bench_client *c) {
    uint32_t rounds = 2 * c->shape.history, n = c->shape.n_frames;
    int64_t start = bench_now_ns() - (int64_t)rounds * PERIOD_NS;
    for (uint32_t i = 0; i < n; i++) {
        name_key key;
        char name[BENCH_NAME_SIZE];
        bench_frame_name(name, i);
        if (names_key(&key, name) || find_locked(c, &key, true) != i) return false;
        c->frames[i].parent = i - 1;
        c->frames[i].depth = i;
    }
    for (uint32_t round = 0; round < rounds; round++)
        for (uint32_t i = 1; i < n; i++) {
            int64_t stamp = start + (int64_t)round * PERIOD_NS + i * 7919000ll % PERIOD_NS;
            shmtf_pose p = bench_pose(i, stamp);
            put_locked(c, i, stamp, stamp, &p);
        }
    return true;
}

static void make_mutex(pthread_mutex_t *m) {
    pthread_mutexattr_t a;
    pthread_mutexattr_init(&a);
    pthread_mutexattr_setpshared(&a, PTHREAD_PROCESS_SHARED);
    pthread_mutexattr_setrobust(&a, PTHREAD_MUTEX_ROBUST);
    pthread_mutex_init(m, &a);
    pthread_mutexattr_destroy(&a);
}

static bool create(char place[BENCH_PLACE_SIZE], const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    bench_client c = {.shape = *shape};
    uint32_t n_buckets = 16;
    unsigned log2 = shmtf_ring_log2_for(shape->history);
    while (n_buckets < 2 * shape->n_frames) n_buckets *= 2;
    size_t size = bind_parts(&c, NULL, shape->n_frames, n_buckets, log2);
    int fd = memfd_create("shmtf-bench-giant", MFD_CLOEXEC); /* no name to remove: it ends with this process */
    void *base = fd < 0 || ftruncate(fd, (off_t)size) ? MAP_FAILED : mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (base == MAP_FAILED) return snprintf(error, BENCH_ERROR_SIZE, "giant: %s", strerror(errno)), false;
    bind_parts(&c, base, shape->n_frames, n_buckets, log2);
    *c.h = (giant_header){.size_bytes = size, .max_frames = shape->n_frames, .n_buckets = n_buckets, .log2 = log2};
    make_mutex(&c.h->mutex);
    bool ok = fill(&c);
    munmap(base, size);
    snprintf(place, BENCH_PLACE_SIZE, "/proc/%ld/fd/%d", (long)getpid(), fd);
    if (!ok) snprintf(error, BENCH_ERROR_SIZE, "giant: names do not fit");
    return ok;
}

static void forget(const char *place) { close(atoi(strrchr(place, '/') + 1)); }

static void detach(bench_client *c) {
    if (!c) return;
    if (c->h) munmap(c->h, c->h->size_bytes);
    free(c->names);
    free(c->keys);
    free(c);
}

static bench_client *attach(const char *place, const bench_shape *shape, bool atomic, char error[BENCH_ERROR_SIZE]) {
    struct stat st;
    bench_client *c = calloc(1, sizeof *c);
    int fd = open(place, O_RDWR | O_CLOEXEC);
    void *base = c && fd >= 0 && !fstat(fd, &st) ? mmap(NULL, (size_t)st.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0) : MAP_FAILED;
    if (fd >= 0) close(fd);
    if (base == MAP_FAILED) return snprintf(error, BENCH_ERROR_SIZE, "giant: %s", strerror(errno)), free(c), NULL;
    const giant_header *h = base;
    bind_parts(c, base, h->max_frames, h->n_buckets, h->log2);
    c->shape = *shape;
    c->atomic = atomic;
    c->keys = calloc(shape->write_len + 1, sizeof *c->keys);
    c->names = calloc(shape->n_frames, sizeof *c->names);
    if (!c->names || !c->keys) return snprintf(error, BENCH_ERROR_SIZE, "no memory"), detach(c), NULL;
    for (uint32_t i = 0; i < shape->n_frames; i++) bench_frame_name(c->names[i], i);
    for (uint32_t i = 0; i < BENCH_POSES; i++) c->poses[i] = bench_written_pose(i);
    return c;
}

static bench_client *attach_giant(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    return attach(place, shape, false, error);
}
static bench_client *attach_atomic(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    return attach(place, shape, true, error);
}

/* Both chains climb to where they meet, the deeper first. */
static bool walk_locked(bench_client *c, uint32_t target, uint32_t source, int64_t *stamps, shmtf_pose *out) {
    shmtf_pose sides[2] = {pose_identity(), pose_identity()}, p;
    uint32_t cur[2] = {source, target}, n = c->shape.read_len;
    uint64_t mask = (1ull << c->h->log2) - 1;
    for (uint32_t k = 0; cur[0] != cur[1]; k++) {
        int side = c->frames[cur[0]].depth >= c->frames[cur[1]].depth ? 0 : 1;
        uint32_t i = cur[side];
        uint64_t slot = (c->frames[i].count - 1) & mask;
        const shmtf_record_body *b = &bodies_of(c, i)[slot];
        if (!c->frames[i].count || k >= n) return false;
        load_pose(b, &p);
        sides[side] = pose_compose(&p, &sides[side]);
        if (stamps) stamps[n - 1 - k] = (int64_t)load_relaxed(&heads_of(c, i)[slot].stamp);
        cur[side] = (uint32_t)load_relaxed(&b->parent);
    }
    shmtf_pose up = pose_inverse(&sides[1]);
    *out = pose_compose(&up, &sides[0]);
    pose_renormalise(out);
    return true;
}

static bool read_chain(bench_client *c, uint32_t first, shmtf_pose *out, int64_t *stamps, char error[BENCH_ERROR_SIZE]) {
    name_key target, source;
    if (!make_key(c, first, &target) || !make_key(c, first + c->shape.read_len, &source)) return false;
    take(c->h);
    uint32_t to = resolve_locked(c, first, &target), from = resolve_locked(c, first + c->shape.read_len, &source);
    bool ok = to != UINT32_MAX && from != UINT32_MAX && walk_locked(c, to, from, stamps, out);
    give(c->h);
    if (!ok) snprintf(error, BENCH_ERROR_SIZE, "giant: no path");
    return ok;
}

static bool write_locked(bench_client *c, uint32_t first, uint32_t i, int64_t stamp_ns, int64_t arrival_ns, const shmtf_pose *p) {
    uint32_t id = resolve_locked(c, first + i, &c->keys[i]), parent = resolve_locked(c, first + i - 1, &c->keys[i - 1]);
    if (id == UINT32_MAX || c->frames[id].parent != parent) return false;
    put_locked(c, id, stamp_ns, arrival_ns, p);
    return true;
}

static bool write_chain(bench_client *c, uint32_t first, int64_t stamp_ns, bool opposite, char error[BENCH_ERROR_SIZE]) {
    uint32_t n = c->shape.write_len;
    int64_t arrival_ns = bench_clock_ns(CLOCK_REALTIME);
    double value;
    bool ok = true;
    for (uint32_t i = 0; i <= n; i++) ok = make_key(c, first + i, &c->keys[i]) && ok;
    if (c->atomic) take(c->h);
    for (uint32_t k = 0; k < n && ok; k++) {
        uint32_t i = opposite ? 1 + k : n - k;
        shmtf_pose p = c->poses[(first + i) % BENCH_POSES];
        ok = !pose_normalise(&p, &value);
        if (!c->atomic) take(c->h);
        ok = ok && write_locked(c, first, i, stamp_ns, arrival_ns, &p);
        if (!c->atomic) give(c->h);
    }
    if (c->atomic) give(c->h);
    if (!ok) snprintf(error, BENCH_ERROR_SIZE, "giant: a frame is missing");
    return ok;
}

static void retries(bench_client *c, uint64_t *reads, uint64_t *writes) {
    (void)c;
    *reads = *writes = 0;
}

const bench_protocol bench_giant = {
    "giant", "one process-shared robust mutex, taken for every frame written and for every lookup", false, false,
    create, forget, attach_giant, detach, read_chain, write_chain, retries,
};
const bench_protocol bench_giant_atomic = {
    "giant-atomic", "one process-shared robust mutex, taken once per update and for every lookup", false, false,
    create, forget, attach_atomic, detach, read_chain, write_chain, retries,
};
