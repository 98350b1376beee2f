/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "snake.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>

enum { FILL_BATCH = 16, PERIOD_NS = 10000000 };

static shmtf_status no_memory(shmtf_error *e) {
    memset(e, 0, sizeof *e);
    e->status = SHMTF_SYSTEM;
    e->sys_errno = ENOMEM;
    e->what = "process memory";
    return SHMTF_SYSTEM;
}

shmtf_status snake_attach(snake *k, const char *name, uint32_t n_frames, shmtf_error *e) {
    memset(k, 0, sizeof *k);
    shmtf_status st = shmtf_attach(name, 0, "shmtf-bench", 0, &k->store, e);
    if (st != SHMTF_OK) return st;
    k->n_frames = n_frames;
    k->period_ns = PERIOD_NS;
    k->names = calloc(n_frames, sizeof *k->names);
    k->frames = calloc(n_frames, sizeof *k->frames);
    k->newest_ns = calloc(n_frames, sizeof *k->newest_ns);
    if (!k->names || !k->frames || !k->newest_ns) return snake_free(k), no_memory(e);
    for (uint32_t i = 0; i < n_frames; i++) {
        bench_frame_name(k->names[i], i);
        if (shmtf_resolve(k->store, NULL, k->names[i], &k->frames[i], NULL) != SHMTF_OK) k->frames[i] = (shmtf_frame){0, 0};
    }
    return SHMTF_OK;
}

shmtf_status snake_make(snake *k, const char *name, uint32_t n_frames, uint32_t history, int64_t cache_time_ns, shmtf_error *e) {
    shmtf_config config;
    memset(k, 0, sizeof *k);
    shmtf_config_default(&config);
    config.max_frames = n_frames;
    config.history = history;
    config.cache_time_ns = cache_time_ns;
    config.stream_bytes = 0;
    shmtf_status st = shmtf_create(name, &config, 0600, e);
    if (st != SHMTF_OK) return st;
    st = snake_attach(k, name, n_frames, e);
    if (st != SHMTF_OK) shmtf_unlink(name, NULL);
    return st;
}

/* All frames in the order of the chain, so that neighbours are neighbours in memory. */
static shmtf_status make_frames(snake *k, shmtf_error *e) {
    shmtf_info info;
    shmtf_status st = shmtf_get_info(k->store, &info, e);
    for (uint32_t i = 0; st == SHMTF_OK && i < k->n_frames; i++)
        st = shmtf_declare_frame(k->store, k->names[i], info.config.history, NULL, e);
    return st;
}

shmtf_status snake_fill(snake *k, uint32_t n_rounds, int64_t end_ns, shmtf_error *e) {
    shmtf_transform items[FILL_BATCH];
    uint32_t n_batches = (k->n_frames - 1 + FILL_BATCH - 1) / FILL_BATCH;
    memset(items, 0, sizeof items);
    k->start_ns = end_ns - (int64_t)n_rounds * PERIOD_NS;
    shmtf_status st = make_frames(k, e);
    if (st != SHMTF_OK) return st;
    for (uint32_t round = 0; round < n_rounds; round++)
        for (uint32_t batch = 0; batch < n_batches; batch++) {
            /* A new edge is checked for a cycle up to the root: the first round goes from the leaf, where that is short. */
            uint32_t first = FILL_BATCH * (round == 0 ? n_batches - 1 - batch : batch);
            uint32_t n = k->n_frames - 1 - first < FILL_BATCH ? k->n_frames - 1 - first : FILL_BATCH;
            for (uint32_t i = 0; i < n; i++) {
                uint32_t child = first + i + 1;
                items[i].parent = snake_ref(k, child - 1, round == 0);
                items[i].child = snake_ref(k, child, round == 0);
                items[i].stamp_ns = k->start_ns + round * k->period_ns + child * 7919000ll % k->period_ns;
                items[i].pose = bench_pose(child, items[i].stamp_ns);
                k->newest_ns[child] = items[i].stamp_ns;
            }
            st = shmtf_set_transforms(k->store, items, n, NULL, NULL, e);
            if (st != SHMTF_OK) return st;
            for (uint32_t i = 0; round == 0 && i < n; i++) {
                k->frames[first + i] = items[i].parent.frame;
                k->frames[first + i + 1] = items[i].child.frame;
            }
        }
    return SHMTF_OK;
}

void snake_free(snake *k) {
    shmtf_close(k->store);
    free(k->names);
    free(k->frames);
    free(k->newest_ns);
    memset(k, 0, sizeof *k);
}
