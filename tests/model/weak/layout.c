/* SPDX-License-Identifier: Apache-2.0
 *
 * E1: a segment is attached while it is being made: not ready yet, or all of it is there.
 */
#include "scenario.h"
#include "segment/layout.c"

enum { WORDS = 8192 };
static _Alignas(4096) uint64_t memory[WORDS];
static shmtf_segment made;
static const uint64_t uuid[2] = {1, 2};

static void *creator(void *unused) {
    (void)unused;
    shmtf_layout_format(&made, uuid, 3, 4);
    shmtf_layout_publish(&made);
    return NULL;
}

static void *attacher(void *unused) {
    (void)unused;
    shmtf_geometry geo;
    const char *why;
    shmtf_header_state state = shmtf_layout_read(memory, made.geo.size_bytes, &geo, &why);
    assert(state == SHMTF_HEADER_OK || state == SHMTF_HEADER_NOT_READY);
    if (state == SHMTF_HEADER_OK) assert(load_relaxed(&made.writers[0].live_from) == 1);
    return NULL;
}

int main(void) {
    pthread_t t[2];
    shmtf_geometry geo;
    if (shmtf_layout_compute(&geo, 1, 2, -1, 0, 1) || geo.size_bytes > sizeof memory) return 1;
    shmtf_layout_bind(&made, &geo, memory);
    pthread_create(&t[0], NULL, creator, NULL);
    pthread_create(&t[1], NULL, attacher, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    return 0;
}
