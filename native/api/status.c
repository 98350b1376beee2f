/* SPDX-License-Identifier: Apache-2.0 */
#include <stdio.h>

#include "api/store.h"

#ifndef SHMTF_VERSION_STRING
#define SHMTF_VERSION_STRING "0.0.0"
#endif

const char *shmtf_version(void) { return SHMTF_VERSION_STRING; }

static const char *const names[] = {"OK",       "LOOKUP",    "CONNECTIVITY", "BACKWARD",         "FORWARD", "NO_DATA",
                                    "INVALID_ARGUMENT", "CYCLE", "OLD_DATA", "EXISTS", "NOT_FOUND", "NOT_READY", "VERSION",
                                    "CORRUPT",  "FULL",      "READ_ONLY",    "BUSY",             "CONFLICT",
                                    "SNAPSHOT_EXPIRED", "CLOSED", "TIMEOUT", "INTERRUPTED", "SYSTEM"};

const char *shmtf_status_name(shmtf_status status) {
    return (unsigned)status < sizeof names / sizeof *names ? names[status] : "UNKNOWN";
}

shmtf_error *error_open(shmtf_error *e) {
    if (!e || e->status != SHMTF_OK) return e;
    memset(e, 0, sizeof *e);
    e->holder_slot = -1;
    e->status = SHMTF_SYSTEM; /* until error_set says which */
    return e;
}

shmtf_status error_set(shmtf_error *e, shmtf_status status, const char *what, const char *hint) {
    if (error_open(e)) {
        e->status = status;
        e->what = what;
        e->hint = hint;
    }
    return status;
}

shmtf_status error_system(shmtf_error *e, shmtf_status status, int sys_errno, const char *what, const char *hint) {
    if (error_open(e)) e->sys_errno = sys_errno;
    return error_set(e, status, what, hint);
}

void error_ref_name(const shmtf_store *h, const shmtf_ref *ref, char out[SHMTF_NAME_SIZE]) {
    out[0] = 0;
    if (ref->name) snprintf(out, SHMTF_NAME_SIZE, "%s", ref->name);
    else if (ref->frame.gen) names_copy(&h->s, ref->frame, out);
}

void error_frame(shmtf_error *e, const shmtf_store *h, const shmtf_ref *parent, const shmtf_ref *child) {
    if (!error_open(e)) return;
    if (parent) error_ref_name(h, parent, e->parent);
    if (child) error_ref_name(h, child, e->child);
}

void store_text(const shmtf_word *words, char out[SHMTF_HOLDER_SIZE]) {
    uint64_t copy[SHMTF_TEXT_WORDS];
    for (int i = 0; i < SHMTF_TEXT_WORDS; i++) copy[i] = load_relaxed(&words[i]);
    memcpy(out, copy, SHMTF_HOLDER_SIZE);
    out[SHMTF_HOLDER_SIZE - 1] = 0;
}

void error_holder(shmtf_error *e, const shmtf_store *h, unsigned slot) {
    if (!error_open(e) || slot >= h->s.geo.max_writers) return;
    const shmtf_writer *w = &h->s.writers[slot];
    e->holder_slot = (int)slot;
    e->holder_pid = (int64_t)load_relaxed(&w->pid);
    store_text(w->text, e->holder);
}

static int describe(const shmtf_error *e, char *b, size_t n) {
    const char *what = e->what ? e->what : "";
    const double s = 1e-9;
    switch (e->status) {
    case SHMTF_LOOKUP: return snprintf(b, n, "frame \"%s\" does not exist", e->child);
    case SHMTF_CONNECTIVITY:
        return snprintf(b, n, "\"%s\" and \"%s\" are not connected%s%s", e->parent, e->child, *what ? ": " : "", what);
    case SHMTF_BACKWARD:
    case SHMTF_FORWARD:
    case SHMTF_NO_DATA:
        return snprintf(b, n, "edge \"%s\" -> \"%s\" has data from %.9f s to %.9f s, asked for %.9f s", e->parent, e->child,
                        (double)e->oldest_ns * s, (double)e->newest_ns * s, (double)e->requested_ns * s);
    case SHMTF_OLD_DATA:
        return snprintf(b, n, "\"%s\" at %.9f s is more than cache_time behind its newest record at %.9f s", e->child,
                        (double)e->requested_ns * s, (double)e->newest_ns * s);
    case SHMTF_CYCLE: return snprintf(b, n, "\"%s\" below \"%s\" would make a cycle", e->child, e->parent);
    case SHMTF_BUSY:
        return snprintf(b, n, "\"%s\" is held by writer %d (pid %lld, %s)", e->child, e->holder_slot, (long long)e->holder_pid,
                        e->holder);
    case SHMTF_FULL:
        return snprintf(b, n, "%s is exhausted: %llu, needed %llu", what, (unsigned long long)e->limit,
                        (unsigned long long)e->needed);
    case SHMTF_SYSTEM: return snprintf(b, n, "%s: %s", what, strerror(e->sys_errno));
    default: return snprintf(b, n, "%s%s%s", shmtf_status_name(e->status), *what ? ": " : "", what);
    }
}

char *shmtf_error_message(const shmtf_error *error, char *buffer, size_t size) {
    int n = describe(error, buffer, size);
    if (error->hint && n >= 0 && (size_t)n < size) snprintf(buffer + n, size - (size_t)n, "; %s", error->hint);
    return buffer;
}
