/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "baseline.h"

#include <errno.h>
#include <fcntl.h>
#include <sched.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/names.h"

enum { PERIOD_NS = 10000000, SPINS = 100 };

_Static_assert(sizeof(baseline_frame) == 64 && sizeof(baseline_name) == 192, "whole lines");

static size_t round_up(size_t n) { return (n + 4095) / 4096 * 4096; }

static void *part(unsigned char *base, size_t *at, size_t bytes) {
    void *start = base ? base + *at : NULL;
    *at += round_up(bytes);
    return start;
}

/* Point the parts into `base`; their size. */
static size_t bind_parts(bench_client *c, unsigned char *base, uint32_t n_frames, uint32_t n_buckets, unsigned log2) {
    size_t at = 0;
    c->ring_bytes = shmtf_ring_bytes(log2, sizeof(shmtf_record_body));
    c->mask = (1ull << log2) - 1;
    c->h = part(base, &at, sizeof *c->h);
    c->buckets = part(base, &at, n_buckets * sizeof *c->buckets);
    c->frames = part(base, &at, n_frames * sizeof *c->frames);
    c->names = part(base, &at, n_frames * sizeof *c->names);
    c->rings = part(base, &at, n_frames * c->ring_bytes);
    return at;
}

/* ---- names ------------------------------------------------------------------------------------------------- */

#define HASH_HALF 0xffffffff00000000ull

static bool same_name(const baseline_name *n, const name_key *key) {
    if (n->hash != key->hash) return false;
    for (unsigned i = 0; i < key->n_words; i++)
        if (n->word[i] != key->word[i]) return false;
    return true;
}

/* UINT32_MAX: no frame has this name. */
static uint32_t find(const bench_client *c, const name_key *key) {
    for (uint64_t i = key->hash;; i++) {
        uint64_t bucket = c->buckets[i & (c->h->n_buckets - 1)];
        uint32_t id = (uint32_t)bucket - 1;
        if (!bucket) return UINT32_MAX;
        if ((bucket ^ key->hash) < 1ull << 32 && same_name(&c->names[id], key)) return id;
    }
}

static void add_name(bench_client *c, const name_key *key, uint32_t id) {
    uint64_t i = key->hash;
    while (c->buckets[i & (c->h->n_buckets - 1)]) i++;
    c->buckets[i & (c->h->n_buckets - 1)] = (key->hash & HASH_HALF) | (id + 1);
    c->names[id].hash = key->hash;
    memcpy(c->names[id].word, key->word, key->n_words * sizeof *key->word);
}

/* Frame `i` of the snake, as this workload's operations give it. */
static uint32_t resolve(const bench_client *c, uint32_t i) {
    name_key key;
    if (!c->shape.by_name) return i;
    return names_key(&key, c->texts[i]) ? UINT32_MAX : find(c, &key);
}

bool baseline_ends(const bench_client *c, uint32_t first, uint32_t *target, uint32_t *source, char error[BENCH_ERROR_SIZE]) {
    *target = resolve(c, first);
    *source = resolve(c, first + c->shape.read_len);
    if (*target != UINT32_MAX && *source != UINT32_MAX) return true;
    snprintf(error, BENCH_ERROR_SIZE, "no frame %s or %s", c->texts[first], c->texts[first + c->shape.read_len]);
    return false;
}

/* ---- writing ----------------------------------------------------------------------------------------------- */

/* The misses of all frames of an update at once, and before a lock is taken. */
static void prefetch_slot(const bench_client *c, uint32_t id) {
    uint64_t slot = load_relaxed(&c->frames[id].count) & c->mask;
    __builtin_prefetch(&baseline_heads(c, id)[slot], 1);
    __builtin_prefetch(&baseline_bodies(c, id)[slot], 1);
}

bool baseline_prepare(bench_client *c, uint32_t first, bool opposite, char error[BENCH_ERROR_SIZE]) {
    uint32_t n = c->shape.write_len, parent = resolve(c, first);
    double value;
    for (uint32_t i = 1; i <= n; i++) {
        baseline_item *item = &c->items[opposite ? i - 1 : n - i];
        uint32_t id = resolve(c, first + i);
        if (id == UINT32_MAX || c->frames[id].parent != parent)
            return snprintf(error, BENCH_ERROR_SIZE, "no frame %s below %s", c->texts[first + i], c->texts[first + i - 1]), false;
        prefetch_slot(c, id);
        item->pose = c->poses[(first + i) % BENCH_POSES];
        if (pose_normalise(&item->pose, &value)) return snprintf(error, BENCH_ERROR_SIZE, "no pose: %g", value), false;
        item->id = parent = id;
    }
    return true;
}

static void move_up(shmtf_word *to, const shmtf_word *from, size_t bytes) {
    for (size_t i = 0; i < bytes / sizeof *to; i++) store_relaxed(&to[i], load_relaxed(&from[i]));
}

static void store_double(shmtf_word *w, double d) {
    uint64_t u;
    memcpy(&u, &d, sizeof u);
    store_relaxed(w, u);
}

/* Append, or first move what is newer up by one. */
void baseline_put(const bench_client *c, const baseline_item *item, int64_t stamp, int64_t arrival) {
    baseline_frame *f = &c->frames[item->id];
    shmtf_record_head *heads = baseline_heads(c, item->id);
    shmtf_record_body *bodies = baseline_bodies(c, item->id);
    uint64_t count = load_relaxed(&f->count), at = count;
    for (; at && count - at < c->mask && (int64_t)load_relaxed(&heads[(at - 1) & c->mask].stamp) > stamp; at--) {
        move_up(&heads[at & c->mask].tag, &heads[(at - 1) & c->mask].tag, sizeof *heads);
        move_up(bodies[at & c->mask].pose, bodies[(at - 1) & c->mask].pose, sizeof *bodies);
    }
    shmtf_record_head *h = &heads[at & c->mask];
    shmtf_record_body *b = &bodies[at & c->mask];
    store_relaxed(&h->stamp, (uint64_t)stamp);
    store_relaxed(&h->arrival, (uint64_t)arrival);
    store_relaxed(&h->info, 0);
    store_double(&b->pose[0], item->pose.x);
    store_double(&b->pose[1], item->pose.y);
    store_double(&b->pose[2], item->pose.z);
    store_double(&b->pose[3], item->pose.qx);
    store_double(&b->pose[4], item->pose.qy);
    store_double(&b->pose[5], item->pose.qz);
    store_double(&b->pose[6], item->pose.qw);
    store_relaxed(&b->parent, f->parent);
    store_relaxed(&f->count, count + 1);
}

void baseline_pause(unsigned *turn) {
    if (++*turn % SPINS) cpu_relax();
    else sched_yield();
}

/* ---- coming and going -------------------------------------------------------------------------------------- */

static void make_mutex(pthread_mutex_t *m) {
    pthread_mutexattr_t a;
    pthread_mutexattr_init(&a);
    pthread_mutexattr_setpshared(&a, PTHREAD_PROCESS_SHARED);
    pthread_mutexattr_setrobust(&a, PTHREAD_MUTEX_ROBUST);
    pthread_mutex_init(m, &a);
    pthread_mutexattr_destroy(&a);
}

static void fill(bench_client *c) {
    uint32_t rounds = 2 * c->shape.history, n = c->shape.n_frames;
    int64_t start = bench_now_ns() - (int64_t)rounds * PERIOD_NS;
    for (uint32_t i = 0; i < n; i++) {
        name_key key;
        char name[BENCH_NAME_SIZE];
        bench_frame_name(name, i);
        names_key(&key, name);
        add_name(c, &key, i);
        c->frames[i].parent = i ? i - 1 : UINT32_MAX;
        c->frames[i].depth = i;
    }
    for (uint32_t round = 0; round < rounds; round++)
        for (uint32_t i = 1; i < n; i++) {
            int64_t stamp = start + (int64_t)round * PERIOD_NS + i * 7919000ll % PERIOD_NS;
            baseline_item item = {i, bench_pose(i, stamp)};
            baseline_put(c, &item, stamp, stamp);
        }
}

static size_t physical_bytes(void) { return (size_t)sysconf(_SC_PHYS_PAGES) * (size_t)sysconf(_SC_PAGESIZE); }

bool baseline_create(char place[BENCH_PLACE_SIZE], const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    bench_client c = {.shape = *shape};
    uint32_t n_buckets = 16;
    unsigned log2 = shmtf_ring_log2_for(shape->history);
    while (n_buckets < 2 * shape->n_frames) n_buckets *= 2;
    size_t size = bind_parts(&c, NULL, shape->n_frames, n_buckets, log2);
    int fd = memfd_create("shmtf-bench-baseline", MFD_CLOEXEC); /* no name to remove: it ends with this process */
    void *base = MAP_FAILED;
    if (size > physical_bytes() / 2) errno = ENOMEM; /* a page that does not exist is a signal, and no error */
    else if (fd >= 0 && !ftruncate(fd, (off_t)size)) base = mmap(NULL, size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    if (base == MAP_FAILED) {
        snprintf(error, BENCH_ERROR_SIZE, "%zu bytes of memory: %s", size, strerror(errno));
        if (fd >= 0) close(fd);
        return false;
    }
    bind_parts(&c, base, shape->n_frames, n_buckets, log2);
    c.h->size_bytes = size;
    c.h->n_frames = shape->n_frames;
    c.h->n_buckets = n_buckets;
    c.h->log2 = log2;
    make_mutex(&c.h->mutex);
    fill(&c);
    munmap(base, size);
    snprintf(place, BENCH_PLACE_SIZE, "/proc/%ld/fd/%d", (long)getpid(), fd);
    return true;
}

void baseline_remove(const char *place) { close(atoi(strrchr(place, '/') + 1)); }

void baseline_detach(bench_client *c) {
    if (!c) return;
    if (c->h) munmap(c->h, c->h->size_bytes);
    free(c->texts);
    free(c->above);
    free(c->items);
    free(c->seen);
    free(c);
}

static void *map_place(const char *place) {
    struct stat st;
    int fd = open(place, O_RDWR | O_CLOEXEC);
    if (fd < 0) return NULL;
    void *base = fstat(fd, &st) ? MAP_FAILED : mmap(NULL, (size_t)st.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    return base == MAP_FAILED ? NULL : base;
}

bench_client *baseline_attach(const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]) {
    bench_client *c = calloc(1, sizeof *c);
    if (!c || !(c->h = map_place(place)))
        return snprintf(error, BENCH_ERROR_SIZE, "%s: %s", place, strerror(errno)), baseline_detach(c), NULL;
    bind_parts(c, (unsigned char *)c->h, c->h->n_frames, c->h->n_buckets, c->h->log2);
    c->shape = *shape;
    c->texts = calloc(shape->n_frames, sizeof *c->texts);
    c->above = calloc(shape->n_frames, sizeof *c->above);
    c->items = calloc(shape->write_len, sizeof *c->items);
    c->seen = calloc(shape->read_len, sizeof *c->seen);
    if (!c->texts || !c->above || !c->items || !c->seen)
        return snprintf(error, BENCH_ERROR_SIZE, "no memory"), baseline_detach(c), NULL;
    for (uint32_t i = 0; i < shape->n_frames; i++) bench_frame_name(c->texts[i], i);
    for (uint32_t i = 0; i < BENCH_POSES; i++) c->poses[i] = bench_written_pose(i);
    return c;
}

void baseline_retries(bench_client *c, uint64_t *reads, uint64_t *writes) {
    *reads = c->read_retries;
    *writes = c->write_retries;
}
