/* SPDX-License-Identifier: Apache-2.0
 *
 * What a recorded history looks like: written by record.c into a mapped file, so that it survives whoever is killed;
 * read by replay.c.
 *
 * An entry is one operation.  `begin` and `end` come from one counter that all processes increment before and after, so
 * "ended before it began" is exact.  An operation that is still under way (PENDING) when its process is killed may have
 * happened or not; so a write is complete in the log before it starts.  Values are never written twice.
 */
#ifndef SHMTF_TESTS_HISTORY_H
#define SHMTF_TESTS_HISTORY_H

#include <stdatomic.h>
#include <stdint.h>

#define HISTORY_MAGIC 0x3179726f74736968ull

enum { GROUP = 16, BANK = 8, FREE = 12, FIRST_GROUP = 1, FIRST_BANK = FIRST_GROUP + GROUP, FIRST_FREE = FIRST_BANK + BANK };
enum { N_NAMES = FIRST_FREE + FREE, MOST_ITEMS = 64, MOST_BUFFERS = 32, BANK_AMOUNT = 100 };

typedef enum {
    OP_SET,
    OP_TRANSFER, /* reads frames and writes them, under their locks */
    OP_REMOVE,
    OP_CLEAR,
    OP_LATEST,
    OP_AT,
    OP_COMMON,
    OP_EXISTS,
    OP_PARENT,
    OP_RECORDS,
    OP_FRAMES,
    OP_SNAPSHOT, /* taken; what is read in it is entries of their own */
    N_OPS
} history_kind;

enum { PENDING = 255 };
enum {
    F_COMMITTED = 1,   /* the store counted a commit */
    F_IN_SNAPSHOT = 2, /* a read in a snapshot that was taken before: its `version` is the snapshot's */
    F_KEEP_STATIC = 4,
    F_STATIC = 8,      /* of an item */
    F_VERSION = 16     /* the answer says which commit it is about; otherwise it is one from `low` to `high` */
};

typedef struct {
    uint16_t child, parent; /* names, of what is written */
    uint32_t flags;
    uint64_t child_handle, parent_handle; /* gen << 24 | id; 0: not known */
    uint64_t version;                     /* of a listed record */
    int64_t stamp;
    double x, y;
    double seen_x, seen_y; /* OP_TRANSFER: what was read before */
} history_item;

typedef struct {
    uint64_t begin, end; /* end 0: it never returned */
    uint64_t version;
    uint64_t low, high; /* the commit word's version before and after */
    int64_t time; /* asked for; of what is pending: when its process was known to be dead, in the order of `begin`; 0: at the end */
    double x, y;
    uint16_t kind, status, flags, n;
    uint16_t target, source;
    uint32_t process;
    /* followed by n items */
} history_entry;

typedef struct {
    uint64_t magic, seed;
    uint64_t live;         /* records that a ring keeps */
    int64_t cache_time_ns; /* negative: all */
    uint64_t n_buffers, buffer_bytes;
    atomic_ullong order, stamp, over, incarnations;
    atomic_ullong used[MOST_BUFFERS]; /* bytes of each buffer */
} history_control;

enum { HISTORY_HEADER = 4096 };
_Static_assert(sizeof(history_control) <= HISTORY_HEADER, "the control block fits its page");
_Static_assert(sizeof(history_entry) == 80 && sizeof(history_item) == 72, "as tests/history/log.py writes them");

static inline history_item *history_items(history_entry *e) { return (history_item *)(void *)(e + 1); }
static inline uint64_t history_size(const history_entry *e) { return sizeof *e + e->n * sizeof(history_item); }

#endif
