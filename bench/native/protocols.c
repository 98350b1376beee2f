/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "protocol.h"

#include <string.h>

static const bench_protocol *const ALL[] = {&bench_shmtf, &bench_giant, &bench_giant_atomic};

const bench_protocol *bench_protocol_at(size_t n) { return n < sizeof ALL / sizeof *ALL ? ALL[n] : NULL; }

const bench_protocol *bench_protocol_find(const char *name) {
    for (size_t i = 0; i < sizeof ALL / sizeof *ALL; i++)
        if (!strcmp(ALL[i]->name, name)) return ALL[i];
    return NULL;
}
