/* SPDX-License-Identifier: Apache-2.0
 *
 * The step hook: counts stores, halts before one of them, or watches that no byte of the segment or of the bell changes
 * but in the word that the step before has announced.
 *
 * Loads are steps too, but a death before a load leaves the same memory as one before the next store.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "api/store.h"
#include "segment/failpoint.h"
#include "trial.h"

enum { BELL_PAGE = 4096, MAX_TOLD = 1 << 16 };

static hook_mode mode;
static const world *watched;
static shmtf_store *handle;
static uint64_t halt_at;
static int halt_signal;
static step_count *counted;
static unsigned char *shadow; /* what the segment and the bell were at the last step */
static uint64_t told[MAX_TOLD]; /* a set of offsets; offsets in the bell begin at the segment's size */

/* Where a word of the library's mappings lies in an image; UINT64_MAX: in none. */
static uint64_t offset_of(const void *word) {
    uint64_t in_segment = (uint64_t)((const unsigned char *)word - (const unsigned char *)handle->base);
    uint64_t in_bell = handle->bell_map ? (uint64_t)((const unsigned char *)word - (const unsigned char *)handle->bell_map) : UINT64_MAX;
    if (in_segment < watched->size) return in_segment;
    return in_bell < BELL_PAGE ? watched->size + in_bell : UINT64_MAX;
}

static void count_word(uint64_t offset) {
    uint64_t at = (offset * 0x9e3779b97f4a7c15ull) >> 48;
    for (; told[at % MAX_TOLD] && told[at % MAX_TOLD] != offset + 1; at++) {}
    if (!told[at % MAX_TOLD]) counted->words++;
    told[at % MAX_TOLD] = offset + 1;
}

/* Nothing but the word announced at `offset` may have changed since the last look. */
static void look(uint64_t offset) {
    const unsigned char *const now[2] = {watched->memory, watched->bell_page};
    const uint64_t size[2] = {watched->size, BELL_PAGE}, from[2] = {0, watched->size};
    if (offset != UINT64_MAX) {
        const unsigned char *word = offset < watched->size ? now[0] + offset : now[1] + (offset - watched->size);
        counted->changed += memcmp(shadow + offset, word, 8) != 0;
        memcpy(shadow + offset, word, 8);
    }
    for (int part = 0; part < 2; part++) {
        if (!memcmp(shadow + from[part], now[part], size[part])) continue;
        for (uint64_t i = 0; i < size[part]; i++)
            if (shadow[from[part] + i] != now[part][i])
                die("store %llu: byte %llu of the %s changed without a step", (unsigned long long)counted->stores, (unsigned long long)i,
                    part ? "bell" : "segment");
    }
}

static void watch(int kind, const void *word) {
    static uint64_t announced = UINT64_MAX;
    look(announced);
    announced = kind == SHMTF_STEP_STORE && word ? offset_of(word) & ~7ull : UINT64_MAX;
}

void shmtf_step(int kind, const void *word) {
    if (mode == HOOK_OFF) return;
    if (mode == HOOK_WATCH) watch(kind, word);
    if (kind != SHMTF_STEP_STORE) {
        counted->loads++;
        return;
    }
    uint64_t k = ++counted->stores;
    if (mode == HOOK_HALT) {
        if (k != halt_at) return;
        mode = HOOK_OFF;
        if (kill(getpid(), halt_signal)) abort();
        return;
    }
    uint64_t offset = offset_of(word);
    if (offset == UINT64_MAX) die("store %llu is to neither segment nor bell", (unsigned long long)k);
    count_word(offset);
    if (word == (const void *)&handle->s.global->commit) counted->commit_at = k;
}

void shmtf_failpoint(const char *name) { (void)name; }

void hook_arm(hook_mode how, const world *w, shmtf_store *h, uint64_t at, int signal_number, step_count *count) {
    watched = w;
    handle = h;
    halt_at = at;
    halt_signal = signal_number;
    counted = count;
    memset(count, 0, sizeof *count);
    mode = how;
}

void hook_shadow(const world *w) {
    if (!shadow) shadow = malloc(w->size + BELL_PAGE);
    if (!shadow) die("no memory");
    world_save(w, shadow);
}

void hook_off(void) {
    if (mode == HOOK_WATCH) watch(SHMTF_STEP_LOAD, NULL);
    mode = HOOK_OFF;
}
