/* SPDX-License-Identifier: Apache-2.0
 *
 * A writer that kills or stops itself inside one write.
 *
 * usage: failpoint_writer STORE OP VALUE [--at NAME [--nth N]] [--signal KILL|STOP] [--list]
 *
 * OP     update  a, b and c below "root" to VALUE, at stamp 10 VALUE, but b late, at 10 VALUE - 15
 *        birth   a new frame "n" below a new frame "m"
 *        remove  "a"       clear   all but static records       declare   a new frame "d" with a history of 40
 *        fixed   a and c become static
 * --at   the N-th time it comes to this failpoint
 * --list prints "NAME N" per failpoint that the write comes by
 * Exit code 0: the write was done; 3: it was refused, with the reason on stderr.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "segment/failpoint.h"
#include "shmtf.h"

enum { MOST_NAMES = 64 };

static int armed, signal_number;
static long nth_wanted = 1;
static const char *name_wanted;
static const char *seen[MOST_NAMES];
static long seen_count[MOST_NAMES];

static void halt(void) {
    armed = 0;
    if (kill(getpid(), signal_number)) abort();
}

void shmtf_failpoint(const char *name) {
    int i = 0;
    if (!armed) return;
    while (i < MOST_NAMES - 1 && seen[i] && strcmp(seen[i], name)) i++;
    seen[i] = name;
    seen_count[i]++;
    if (name_wanted && !strcmp(name, name_wanted) && seen_count[i] == nth_wanted) halt();
}

static shmtf_transform edge(const char *parent, const char *child, int64_t stamp, double x, unsigned flags) {
    return (shmtf_transform){shmtf_by_name(parent), shmtf_by_name(child), stamp, {x, 0, 0, 0, 0, 0, 1}, flags};
}

static shmtf_status run(shmtf_store *h, const char *op, double value, shmtf_error *e) {
    const shmtf_write_options wait = {.timeout_ns = -1};
    const int64_t t = (int64_t)value * 10;
    if (!strcmp(op, "update")) {
        shmtf_transform batch[3] = {edge("root", "a", t, value, 0), edge("root", "b", t - 15, value, 0), edge("root", "c", t, value, 0)};
        return shmtf_set_transforms(h, batch, 3, &wait, NULL, e);
    }
    if (!strcmp(op, "birth")) {
        shmtf_transform batch[1] = {edge("m", "n", t, value, 0)};
        return shmtf_set_transforms(h, batch, 1, &wait, NULL, e);
    }
    if (!strcmp(op, "fixed")) {
        shmtf_transform batch[2] = {edge("root", "a", t, value, SHMTF_STATIC), edge("root", "c", t, value, SHMTF_STATIC)};
        return shmtf_set_transforms(h, batch, 2, &wait, NULL, e);
    }
    if (!strcmp(op, "remove")) return shmtf_remove_frame(h, shmtf_by_name("a"), &wait, e);
    if (!strcmp(op, "clear")) return shmtf_clear(h, 1, &wait, e);
    if (!strcmp(op, "declare")) return shmtf_declare_frame(h, "d", 40, &wait, e);
    fprintf(stderr, "no such OP: %s\n", op);
    exit(2);
}

int main(int argc, char **argv) {
    int list = 0;
    shmtf_store *h;
    shmtf_error e;
    char text[256];
    signal_number = SIGKILL;
    if (argc < 4) return 2;
    for (int i = 4; i < argc; i++) {
        const char *more = i + 1 < argc ? argv[i + 1] : "";
        if (!strcmp(argv[i], "--list")) list = 1;
        else if (!strcmp(argv[i], "--at")) name_wanted = more, i++;
        else if (!strcmp(argv[i], "--nth")) nth_wanted = atol(more), i++;
        else if (!strcmp(argv[i], "--signal")) signal_number = !strcmp(more, "STOP") ? SIGSTOP : SIGKILL, i++;
        else return 2;
    }
    if (shmtf_attach(argv[1], 0, "failpoint_writer", 0, &h, &e)) {
        fprintf(stderr, "%s\n", shmtf_error_message(&e, text, sizeof text));
        return 2;
    }
    armed = 1;
    shmtf_status st = run(h, argv[2], atof(argv[3]), &e);
    armed = 0;
    if (list) {
        for (int i = 0; i < MOST_NAMES && seen[i]; i++) printf("%s %ld\n", seen[i], seen_count[i]);
    }
    if (st) fprintf(stderr, "%s\n", shmtf_error_message(&e, text, sizeof text));
    shmtf_close(h);
    return st ? 3 : 0;
}
