/* SPDX-License-Identifier: Apache-2.0
 *
 * Whole segments to begin with.  Each world is a tree that grows through the public interface: a deep chain, a star, turned
 * rings, late stamps, static frames, removed names and names used again, declared rings, clears.  An image is taken in
 * between, and inside each kind of write at every named step: that is what a writer leaves that is killed there.
 */
#define _GNU_SOURCE
#include "fuzz.h"

#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

enum { MOST_IMAGES = 320, PER_STEP = 2, MOST_STEPS = 48 };

static const shmtf_config worlds[N_WORLDS] = {
    {.max_frames = 24, .history = 6, .cache_time_ns = 1000, .stream_bytes = 1 << 14, .max_writers = 4},
    {.max_frames = 7, .history = 14, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 2},
};

char image_names[N_NAMES][8];
static image images[MOST_IMAGES];
static unsigned n_images;

/* The world that is being made. */
static struct {
    unsigned world;
    const unsigned char *base;
    uint64_t size;
    shmtf_store *h;
    int64_t now;
    bool dying;
    const char *seen[MOST_STEPS];
    unsigned times[MOST_STEPS];
} making;

void image_geometry(unsigned world, shmtf_geometry *geo) {
    const shmtf_config *c = &worlds[world];
    if (shmtf_layout_compute(geo, c->max_frames, c->history, c->cache_time_ns, c->stream_bytes, c->max_writers)) abort();
}

static void take_image(const char *what) {
    if (n_images == MOST_IMAGES) return;
    unsigned char *copy = malloc(making.size);
    if (!copy) abort();
    memcpy(copy, making.base, making.size);
    images[n_images++] = (image){what, making.world, making.size, copy};
}

void images_failpoint(const char *name) {
    unsigned i = 0;
    if (!making.dying) return;
    while (i < MOST_STEPS - 1 && making.seen[i] && strcmp(making.seen[i], name)) i++;
    making.seen[i] = name;
    if (making.times[i]++ < PER_STEP) take_image(name);
}

/* The next write is imaged at its named steps. */
static void die_in_next(void) {
    memset(making.seen, 0, sizeof making.seen);
    memset(making.times, 0, sizeof making.times);
    making.dying = true;
}

static void done(shmtf_status st, const char *what) {
    making.dying = false;
    if (st) fprintf(stderr, "images: %s: %s\n", what, shmtf_status_name(st)), abort();
    take_image(what);
}

static shmtf_transform edge(unsigned parent, unsigned child, int64_t stamp) {
    const double x = (double)stamp;
    return (shmtf_transform){shmtf_by_name(image_names[parent]), shmtf_by_name(image_names[child]), stamp, {x, 1, 2, 0, 0, 0.6, 0.8}, 0};
}

static void write_chain(unsigned first, unsigned last, const char *what) {
    shmtf_transform items[N_NAMES];
    size_t n = 0;
    making.now += 10;
    for (unsigned i = first; i < last; i++) items[n++] = edge(i, i + 1, making.now);
    done(shmtf_set_transforms(making.h, items, n, NULL, NULL, NULL), what);
}

static void write_one(unsigned parent, unsigned child, int64_t stamp, unsigned flags, const char *what) {
    shmtf_transform item = edge(parent, child, stamp);
    item.flags = flags;
    done(shmtf_set_transforms(making.h, &item, 1, NULL, NULL, NULL), what);
}

static void grow_small(void) {
    write_chain(0, 4, "small chain");
    for (int i = 0; i < 20; i++) write_chain(0, 3, "small, rings turning");
    die_in_next();
    write_one(1, 2, making.now - 35, 0, "small, late");
    write_one(0, 5, 1, SHMTF_STATIC, "small, static");
    die_in_next();
    done(shmtf_remove_frame(making.h, shmtf_by_name(image_names[3]), NULL, NULL), "small, removed");
    write_one(0, 6, making.now, 0, "small, full of frames");
}

static void grow_large(void) {
    take_image("empty");
    die_in_next();
    write_chain(0, 10, "chain");
    for (unsigned i = 11; i < 15; i++) write_one(0, i, making.now, 0, "star");
    for (int i = 0; i < 8; i++) write_chain(0, 9, "turning");
    die_in_next();
    write_chain(0, 3, "update");
    for (int i = 0; i < 3; i++) write_one(2, 3, making.now - 15 - 10 * i, 0, "late");
    die_in_next();
    write_one(3, 4, making.now - 25, 0, "late, dying");
    die_in_next();
    write_one(0, 15, 0, SHMTF_STATIC, "static, born");
    die_in_next();
    write_one(9, 10, 0, SHMTF_STATIC, "moving turns static");
    die_in_next();
    done(shmtf_declare_frame(making.h, image_names[16], 40, NULL, NULL), "declared");
    write_one(5, 16, making.now, 0, "declared, written");
    die_in_next();
    write_one(2, 11, making.now + 1, 0, "reparented");
    die_in_next();
    done(shmtf_remove_frame(making.h, shmtf_by_name(image_names[12]), NULL, NULL), "removed");
    done(shmtf_remove_frame(making.h, shmtf_by_name(image_names[6]), NULL, NULL), "removed amid a chain");
    die_in_next();
    write_one(1, 17, making.now, 0, "frame used again");
    write_one(5, 6, making.now, 0, "name used again");
    die_in_next();
    done(shmtf_clear(making.h, 1, NULL, NULL), "cleared");
    write_chain(0, 5, "after the clear");
    die_in_next();
    done(shmtf_clear(making.h, 0, NULL, NULL), "all cleared");
    for (int i = 0; i < 4; i++) write_chain(0, 10, "again");
}

static void make_world(unsigned world) {
    shmtf_error e;
    int fd = memfd_create("shmtf-fuzz-image", MFD_CLOEXEC);
    making.world = world;
    making.size = shmtf_segment_size(&worlds[world], &e);
    if (fd < 0 || !making.size || shmtf_format_fd(fd, &worlds[world], &e)) abort();
    making.base = mmap(NULL, making.size, PROT_READ, MAP_SHARED, fd, 0);
    if (making.base == MAP_FAILED || shmtf_attach_fd(fd, 0, "images", &making.h, &e)) abort();
    making.now = 1000;
    if (world == 0) grow_large();
    else grow_small();
    shmtf_close(making.h);
    munmap((void *)(uintptr_t)making.base, making.size);
    close(fd);
}

const image *images_all(unsigned *n) {
    for (int i = 0; i < N_NAMES; i++) snprintf(image_names[i], sizeof image_names[i], "n%d", i);
    if (!n_images)
        for (unsigned world = 0; world < N_WORLDS; world++) make_world(world);
    *n = n_images;
    return images;
}

const image *images_begin(const uint8_t *data, size_t size) {
    unsigned n;
    const image *all = images_all(&n);
    take_from(data, size);
    tally.inputs++;
    return &all[take(n)];
}
