/* SPDX-License-Identifier: Apache-2.0
 *
 * A store that holds the snake of common.h, and what a benchmark needs to ask it and to write to it.
 */
#ifndef SHMTF_BENCH_SNAKE_H
#define SHMTF_BENCH_SNAKE_H

#include <stdbool.h>

#include "common.h"

typedef struct {
    shmtf_store *store;
    uint32_t n_frames;
    int64_t start_ns, period_ns; /* of the records that snake_fill wrote */
    char (*names)[BENCH_NAME_SIZE];
    shmtf_frame *frames;
    int64_t *newest_ns; /* per frame: stamp of the newest record that snake_fill wrote; the caller may keep it up */
} snake;

/* A new store under this name, attached.  history: records per frame. */
shmtf_status snake_make(snake *k, const char *name, uint32_t n_frames, uint32_t history, int64_t cache_time_ns, shmtf_error *e);
/* An existing one. */
shmtf_status snake_attach(snake *k, const char *name, uint32_t n_frames, shmtf_error *e);
/* Write every frame `n_rounds` times, 10 ms apart, the last time just before end_ns; every frame has its own phase, as on
 * a real robot. */
shmtf_status snake_fill(snake *k, uint32_t n_rounds, int64_t end_ns, shmtf_error *e);
void snake_free(snake *k);

static inline shmtf_ref snake_ref(const snake *k, uint32_t i, bool by_name) {
    return by_name ? shmtf_by_name(k->names[i]) : shmtf_by_handle(k->frames[i]);
}

#endif
