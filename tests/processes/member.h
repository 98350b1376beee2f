/* SPDX-License-Identifier: Apache-2.0
 *
 * One of many processes on one store: how it joins, and how it ends when an answer is wrong.
 */
#ifndef SHMTF_TESTS_MEMBER_H
#define SHMTF_TESTS_MEMBER_H

#include <stdio.h>
#include <unistd.h>

#include "shmtf.h"

static inline void stop(const char *what, const shmtf_error *e) {
    char text[256] = "";
    if (e) shmtf_error_message(e, text, sizeof text);
    fprintf(stderr, "process %d: %s %s\n", (int)getpid(), what, text);
    _exit(1);
}

static inline shmtf_store *join(const char *store_name, unsigned flags) {
    shmtf_store *h;
    shmtf_error e;
    if (shmtf_attach(store_name, flags, NULL, 0, &h, &e)) stop("attach", &e);
    return h;
}

#endif
