/* SPDX-License-Identifier: Apache-2.0
 *
 * The board: a file that all members of the long run map, outside of the stores.  It outlives the members, so that what
 * they counted and what they saw is not lost when they are killed.  ../board.py reads and writes the same words.
 */
#ifndef SHMTF_SOAK_BOARD_H
#define SHMTF_SOAK_BOARD_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#include "shmtf.h"

enum { PAGE_WORDS = 512, SINGLES = 48, BUCKETS = 160 };

/* What members do, in the order of board.py's names. */
enum op {
    OP_SINGLE, OP_LATE, OP_CHAIN, OP_GROUPS, OP_BIG, OP_BIRTH, OP_REMOVE, OP_REPARENT, OP_CYCLE, OP_FLIP, OP_DECLARE, OP_CLEAR,
    OP_BUSY, OP_LATEST, OP_AT_TIME, OP_NO_ANSWER, OP_SNAPSHOT, OP_READ_CHAIN, OP_READ_BIG, OP_READ_SHAPE, OP_DUMP, OP_EXPIRED,
    OP_WOKEN, OP_TIMED_OUT, N_OPS
};

typedef atomic_llong word;

/* The first page is everybody's. */
typedef struct {
    word over, stamp;
    word version[2];             /* of each store: the last commit whose writer has been told so */
    word pad[12];
    word single_stamp[SINGLES];  /* the newest stamp of which that is true */
    word single_version[SINGLES];
    word py_stamp[SINGLES];      /* the same by the member in Python, who cannot raise a word atomically */
    word py_version[SINGLES];
    word chain_stamp, big_stamp;
} board_globals;

/* A page for each member, and for those who take its place after it was killed. */
typedef struct {
    word pid, stops, violated, pad[5];
    word ops[N_OPS];
    word counters[9];
    word worst_read, worst_read_cpu, worst_write;
    word pad1[20];
    word read[BUCKETS], write[BUCKETS];
    word pad2[64];
    char text[512];
} board_cell;

_Static_assert(sizeof(board_globals) <= 8 * PAGE_WORDS && sizeof(board_cell) == 8 * PAGE_WORDS, "pages");
_Static_assert(N_OPS == 24 && __builtin_offsetof(board_cell, read) == 8 * 64, "as board.py has it");

extern board_globals *board;
extern board_cell *cell;

void board_open(const char *path, int number);
static inline void count_op(enum op op) { atomic_fetch_add_explicit(&cell->ops[op], 1, memory_order_relaxed); }
static inline bool over(void) { return atomic_load_explicit(&board->over, memory_order_relaxed) != 0; }
static inline void raise_word(word *w, long long v) {
    long long old = atomic_load(w);
    while (old < v && !atomic_compare_exchange_weak(w, &old, v)) {
    }
}

/* A promise was broken: says so on the board and ends the process. */
_Noreturn void violation(const char *what, const shmtf_error *e);
_Noreturn void violation_numbers(const char *what, long long a, long long b);

/* How long a call took.  What was stopped meanwhile does not count. */
typedef struct {
    long long stops, wall, cpu;
} stopwatch;
stopwatch watch_start(void);
void watch_read(const stopwatch *w);
void watch_write(const stopwatch *w);
/* Adds what the handle has counted since the last call. */
void board_counters(shmtf_store *h, shmtf_counters *last);

#endif
