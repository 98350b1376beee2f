/* SPDX-License-Identifier: Apache-2.0
 *
 * shmtf-micro: the table of micro.h without Python.
 */
#define _GNU_SOURCE
#include <stdlib.h>
#include <string.h>
#include <stdbool.h>

#include "micro.h"

static int usage(void) {
    fputs("usage: shmtf-micro [--frames N,N,..] [--history N,N,..] [--depth N] [--rounds N] [--round-ms N] [--cpu N] [--only TEXT]\n"
          "                   [--peer LIBRARY] [--json FILE]\n", stderr);
    return 2;
}

static size_t numbers(const char *text, uint32_t *out, size_t max) {
    size_t n = 0;
    for (char *end; n < max && *text; text = *end == ',' ? end + 1 : end) {
        out[n++] = (uint32_t)strtoul(text, &end, 10);
        if (end == text) return 0;
    }
    return n;
}

static void print(const micro_options *o, const micro_result *result) {
    const micro_row *rows = result->rows;
    printf("\n%u frames, history %u; ns of processor time per call, median (min .. max) of %d rounds\n", o->n_frames, o->history, o->rounds);
    for (size_t i = 0; i < result->n; i++) {
        printf("  %-16s %8.1f (%8.1f .. %8.1f)", rows[i].name, rows[i].ns.median, rows[i].ns.min, rows[i].ns.max);
        if (rows[i].ratio > 0) printf("  %5.2f x %-15s", rows[i].ratio, rows[i].floor);
        else printf("  %-23s", "");
        printf("  %s\n", rows[i].what);
    }
    if (*result->without_peer) printf("  without the peer: %s\n", result->without_peer);
}

static void print_json(FILE *f, const micro_options *o, const micro_result *result, bool *first) {
    for (size_t i = 0; i < result->n; i++) {
        const micro_row *r = &result->rows[i];
        fprintf(f, "%s\n  {\"name\": \"%s\", \"frames\": %u, \"history\": %u, \"rounds\": %d, ", *first ? "" : ",", r->name,
                o->n_frames, o->history, o->rounds);
        fprintf(f, "\"median_ns\": %.2f, \"min_ns\": %.2f, \"max_ns\": %.2f, ", r->ns.median, r->ns.min, r->ns.max);
        if (r->floor) fprintf(f, "\"floor\": \"%s\", \"ratio\": %.3f}", r->floor, r->ratio);
        else fputs("\"floor\": null, \"ratio\": null}", f);
        *first = false;
    }
}

int main(int argc, char **argv) {
    uint32_t frames[8] = {17, 512, 10000}, history[8] = {16, 128};
    size_t n_frames = 3, n_history = 2;
    micro_options o = {.depth = 16, .rounds = 7, .round_ns = 20000000, .cpu = -1};
    const char *json = NULL;
    for (int i = 1; i < argc; i += 2) {
        const char *key = argv[i], *value = i + 1 < argc ? argv[i + 1] : NULL;
        if (!value) return usage();
        if (!strcmp(key, "--frames")) n_frames = numbers(value, frames, 8);
        else if (!strcmp(key, "--history")) n_history = numbers(value, history, 8);
        else if (!strcmp(key, "--depth")) o.depth = (uint32_t)atoi(value);
        else if (!strcmp(key, "--rounds")) o.rounds = atoi(value);
        else if (!strcmp(key, "--round-ms")) o.round_ns = atoll(value) * 1000000;
        else if (!strcmp(key, "--cpu")) o.cpu = atoi(value);
        else if (!strcmp(key, "--only")) o.only = value;
        else if (!strcmp(key, "--peer")) o.peer = value;
        else if (!strcmp(key, "--json")) json = value;
        else return usage();
    }
    if (!n_frames || !n_history || o.rounds < 1 || o.rounds > MICRO_MAX_ROUNDS || o.round_ns < 1) return usage();
    if (!o.depth || o.depth > MICRO_MAX_DEPTH) return usage();
    for (size_t i = 0; i < n_frames; i++)
        if (frames[i] <= MICRO_WRITE_LEN || frames[i] <= o.depth) return usage();
    FILE *f = json ? fopen(json, "w") : NULL;
    if (json && !f) return perror(json), 1;
    bool first = true;
    if (f) fputs("[", f);
    for (size_t h = 0; h < n_history; h++)
        for (size_t i = 0; i < n_frames; i++) {
            micro_result result;
            shmtf_error e;
            char message[512];
            o.n_frames = frames[i];
            o.history = history[h];
            shmtf_status st = micro_run(&o, &result, &e);
            if (st == SHMTF_FULL) {
                printf("\n%u frames, history %u: skipped, shared memory is too small\n", o.n_frames, o.history);
                continue;
            }
            if (st != SHMTF_OK) return fprintf(stderr, "%s\n", shmtf_error_message(&e, message, sizeof message)), 1;
            print(&o, &result);
            if (f) print_json(f, &o, &result, &first);
        }
    if (f) fputs("\n]\n", f);
    return f && fclose(f) ? 1 : 0;
}
