/* SPDX-License-Identifier: Apache-2.0
 *
 * Death and stop at every store: what the two programs of this folder share.
 *
 * Idea.  A *world* is a small store with a known tree, kept as an image.  A *trial* puts the image back, lets a real
 * process run one operation, kills or stops it at one step, and asks a fresh process what the store is now.  What readers
 * may see is known in advance: the *views* before and after the operation, made in clean runs.
 *
 *   world.c         the store, its images, processes with a watchdog
 *   operations.c    what is done to it
 *   view.c          all that readers see, as numbers to compare
 *   check.c         what a fresh process verifies after a death: all or nothing, recovery, the next writers
 *   trial.c         kill, second kill and stop, before the k-th store    (program `prove`, built with step hooks)
 *   hook.c          counts stores, halts before one, sees that none escapes the count
 *   prove.c         the loops, the workers and the table                 (program `prove`)
 *   ptraced.c       to the n-th machine instruction                      (program `prove_instructions`, built as shipped)
 *   instructions.c  kill after the n-th machine instruction
 */
#ifndef SHMTF_TESTS_PROVE_H
#define SHMTF_TESTS_PROVE_H

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>

#include "shmtf.h"

enum {
    CORE_FRAMES = 8,  /* root a b c d e s other */
    UNBORN_FRAMES = 4, /* m n x dd: names that operations give */
    N_TIMES = 4,
    WATCHDOG_S = 30,
    FAILED = 100 /* exit code of a process that found something wrong, and said what */
};

/* ---- world.c */

typedef struct {
    char store[64], path[80], bell[80];
    uint32_t extra;          /* frames u000, u001, .. beside those of the core */
    uint32_t n_names;        /* of all frames that ever exist */
    uint64_t size;           /* of the segment; an image is that and a page for the bell */
    unsigned char *memory, *bell_page;
    int fd;
    void *first_slot;        /* the kernel lock of writer slot 0, while we hold it */
} world;

void world_make(world *w, const char *store, uint32_t extra);
void world_drop(world *w);
unsigned char *world_new_image(const world *w);
void world_save(const world *w, unsigned char *image);
void world_restore(const world *w, const unsigned char *image);
/* While slot 0 is held, the next process claims slot 1, which victims use: it adopts.  While it is not, the next
 * process claims slot 0 and meets what a victim left in slot 1. */
void world_hold_first_slot(world *w, bool hold);
uint64_t world_version(const world *w); /* of the last commit, read raw */
const char *world_name(uint32_t i, char buffer[16]);

void *shared_memory(uint64_t size);
void die(const char *format, ...) __attribute__((format(printf, 1, 2), noreturn));
shmtf_store *attach_or_die(const world *w, unsigned flags, const char *writer);
void must(shmtf_status st, const shmtf_error *e, const char *what);

/* Run in a process of its own, which a watchdog ends; wait_for gives its wait status. */
pid_t start_process(void (*run)(void *), void *argument);
int wait_for(pid_t pid, int options);

/* ---- operations.c */

typedef struct operation {
    const char *name, *what;
    uint32_t extra;           /* of the world that it needs */
    shmtf_status (*run)(shmtf_store *h, shmtf_error *e);
    const char *frames[5];    /* what it writes, as far as others may write it too */
    bool leaves_records;      /* each of its frames keeps one record of it, whatever comes later */
    bool cold;                /* claiming a writer slot is a part of it */
    bool wakes;               /* somebody waits for what it writes */
    const char *first;        /* an operation whose writer died before */
    enum { DIED_UNDECIDED = 1, DIED_PREPARED, DIED_COMMITTED, DIED_HALF_UNLOCKED } died;
    bool meets;               /* the dead one's locks are met by a writer with another slot */
} operation;

extern const operation operations[];
extern const unsigned n_operations;
const operation *operation_named(const char *name);

shmtf_status write_nothing(shmtf_store *h, shmtf_error *e);           /* claims a slot, if need be */
shmtf_status write_base(shmtf_store *h, uint32_t extra, shmtf_error *e);
shmtf_status write_again(shmtf_store *h, uint32_t extra, shmtf_error *e); /* what a recoverer writes: one commit */
shmtf_status write_probe(shmtf_store *h, uint32_t extra, int64_t stamp, shmtf_error *e); /* every frame, and all free ones */
shmtf_status write_frame(shmtf_store *h, const char *name, int64_t stamp, shmtf_error *e); /* without waiting */
extern const int64_t view_times[N_TIMES];
const char *parent_name_of(const char *frame); /* as write_base made it */

/* ---- view.c */

enum {
    VIEW_LATEST = 16,                            /* words of a frame that are read each time */
    VIEW_DETAIL = 14 + 4 * N_TIMES,              /* and those that cost more */
    VIEW_WORDS = VIEW_LATEST + VIEW_DETAIL
};

typedef struct {
    uint64_t word[VIEW_WORDS];
} frame_view;

/* What all readers see: one per name, and a last one about the whole store. */
frame_view *new_views(const world *w);
typedef struct {
    bool live;               /* not at a snapshot */
    uint32_t stride, phase;  /* details of frames i with i % stride == phase */
    int64_t worst_ns;        /* out: slowest single lookup */
} view_how;
void view_take(const world *w, shmtf_store *h, view_how *how, frame_view *out);
/* Is `seen`, taken with `how`, equal to `expected`?  Else *why says where. */
bool view_equal(const world *w, const frame_view *expected, const frame_view *seen, const view_how *how, char why[200]);

/* ---- check.c */

enum { BEFORE, AFTER, BEFORE_AND_AGAIN, AFTER_AND_AGAIN, N_STATES }; /* "again": write_again was done on top */

typedef enum { BY_ADOPTING, BY_MEETING, BY_REPAIR } recovery;

typedef struct {
    const world *w;
    const operation *op;
    frame_view *state[N_STATES], *seen;
    unsigned char *scratch;  /* an image */
} reference;

typedef struct { /* shared by all processes of a run */
    _Atomic uint64_t killed, killed_twice, stopped, failures, checks;
    _Atomic int64_t worst_read_ns, worst_write_ns, sum_write_ns;
    _Atomic uint64_t writes_timed;
} tally;

typedef struct {
    reference *ref;
    tally *t;
    unsigned allowed;     /* bits of the states that may be seen */
    recovery how;
    bool second;          /* a recoverer was killed too: two slots may hold locks */
    bool thorough;        /* all ways to read, and the probe */
    uint32_t phase;       /* which details of a large world */
    char label[96];
} verdict;

/* Runs in a fresh process; exits with the state that was seen, or FAILED. */
void check_after_death(void *verdict_);
/* What is seen: one of the allowed states, or the process ends as FAILED. */
int check_views(const verdict *v, shmtf_store *h, bool all_ways);
void check_clean(const verdict *v, shmtf_store *h);
void raise_worst(_Atomic int64_t *worst, int64_t ns);
int64_t now_ns(void);

/* The reference views; `perform` runs an operation undisturbed. */
void reference_make(reference *r, world *w, const operation *op, const unsigned char *image);

#endif
