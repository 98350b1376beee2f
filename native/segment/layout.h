/* SPDX-License-Identifier: Apache-2.0
 *
 * What stands where in a segment, told once.  Everything is 64-bit words at fixed offsets from the start:
 *
 *   header        1 page        written before the segment has a name, never again; `format` is written last
 *   global        2 lines       the commit word alone in its line; the topology word and allocation hints
 *   writers       192 B each    per writer slot: transaction state, and who it is (for people)
 *   authorities   128 B each    texts that records refer to by index
 *   buckets       64 B each     name table: 7 hints and a floor
 *   frames        256 B each    per frame: the lines every read and write of it touches, with its newest record
 *   names         128 B each
 *   inline rings  384 B each    4 records per frame: roots, static frames, removals
 *   chunks        8 B each      who owns each piece of the arena
 *   arena         512 B each    rings: records' heads, bodies and order indexes
 *
 * Id 0 of the frames is the series of clears; the user's frames are 1 .. max_frames.
 */
#ifndef SHMTF_SEGMENT_LAYOUT_H
#define SHMTF_SEGMENT_LAYOUT_H

#include <stddef.h>

#include "segment/atomic.h"

#define SHMTF_MAGIC 0x0a1a0066746d6873ull /* "shmtf\0" and two bytes that text transfers would change */

enum {
    SHMTF_PAGE = 4096,
    SHMTF_CHUNK_BYTES = 512,
    SHMTF_BUCKET_HINTS = 7,
    SHMTF_NAME_WORDS = 16,
    SHMTF_TEXT_WORDS = 12,
    SHMTF_N_AUTHORITIES = 256,
    SHMTF_POSE_WORDS = 7,
    SHMTF_INLINE_LOG2 = 2, /* 4 records: 2 live, 2 spare */
    SHMTF_MAX_FRAMES = (1 << 24) - 2,
    SHMTF_MAX_WRITERS = 1023,
    SHMTF_MAX_RING_LOG2 = 22
};

/* Written once by the creator.  Copied to private memory at attach and never looked at again. */
typedef struct {
    shmtf_word magic, format, fingerprint, size_bytes;
    shmtf_word uuid[2], created_ns, creator_pid;
    shmtf_word max_frames, history, cache_time_ns, stream_bytes, max_writers;
    shmtf_word n_buckets, n_chunks;
    shmtf_word off_writers, off_authorities, off_buckets, off_frames, off_names, off_inline, off_chunks, off_arena;
    shmtf_word time_namespace; /* reserved for the store's clock */
} shmtf_header;

typedef struct {
    shmtf_word commit; /* slot:10 | version:54.  Its change is the commit of everything a transaction wrote */
    shmtf_word pad0[7];
    shmtf_word topology;   /* version of the last finished commit that changed the tree's shape; only grows */
    shmtf_word frame_hint; /* where to look for a free frame next: any value is right */
    shmtf_word chunk_hint; /* where to look for free chunks next: any value is right */
    shmtf_word frames_bound; /* highest frame id ever bound; only grows */
    shmtf_word reach;        /* buckets a name may lie beyond its own; only grows */
    shmtf_word pad1[3];
} shmtf_global;

typedef struct {
    shmtf_word state;     /* kind:2 | topology:1 | 0:7 | version:54 */
    shmtf_word txn;       /* number of the slot's last transaction; never reset */
    shmtf_word live_from; /* transactions below this one belong to dead owners */
    shmtf_word pad[5];
    shmtf_word pid, start_ns; /* for people, never for decisions */
    shmtf_word text[SHMTF_TEXT_WORDS];
    shmtf_word pad1[2];
} shmtf_writer;

typedef struct {
    shmtf_word claim; /* 0 free | hash of the text with bit 0 set: being written | with bit 1 set: ready */
    shmtf_word text[SHMTF_TEXT_WORDS];
    shmtf_word pad[3];
} shmtf_authority;

typedef struct {
    shmtf_word hint[SHMTF_BUCKET_HINTS]; /* hash:16 | gen:24 | id:24; garbage where the frame's gen differs */
    shmtf_word floor; /* a miss in this bucket says nothing about commits before this version */
} shmtf_bucket;

/* A frame.  Beside the lock stands a copy of the newest record, which is what most lookups want: one copy for each of the
 * two heads, so two lines of four tell the newest edge. */
typedef struct {
    shmtf_word lock;    /* owned:1 | sel:1 | slot:10 | txn:52 -- the writer flag; free words keep their last owner */
    shmtf_word gen;     /* times bound, doubled; odd while a name is being bound */
    shmtf_word newest_tag[2];   /* as in the record's head; 0: the ring is empty */
    shmtf_word newest_stamp[2];
    shmtf_word newest_edge[2];  /* flags:4 | kind:4 | parent:56 */
    struct {
        shmtf_word pose[SHMTF_POSE_WORDS];
        shmtf_word pad;
    } newest[2];
    shmtf_word head[2]; /* indexed:1 | big:1 | flips:14 | count:48; lock.sel names the one in force */
    shmtf_word newest_search[2]; /* period:40 | base:24; period: ns since the record before, 0: unknown, a hint */
    shmtf_word ring;    /* offset in the arena | used:1 (bit 5) | log2:5; of the big ring, fixed while a head is about it */
    shmtf_word floor;   /* this life began after this version */
    shmtf_word want;    /* a waiting writer's lock word, or 0: others give way; with sel: it has priority */
    shmtf_word first;   /* no life of this frame began before this version; 0: it was never bound */
} shmtf_frame_words_t;

typedef struct {
    shmtf_word word[SHMTF_NAME_WORDS]; /* bytes, zero padded */
} shmtf_name_t;

/* A record's head.  tag: 0 never written | owned lock word without sel | version of its commit. */
typedef struct {
    shmtf_word tag;
    shmtf_word stamp;   /* int64 ns */
    shmtf_word arrival; /* int64 ns CLOCK_REALTIME */
    shmtf_word info;    /* epoch:16 | writer:16 | flags:4 | kind:4 | base:24 */
} shmtf_record_head;

/* A record's body, of a frame: x y z qx qy qz qw, and the parent as unused:8 | gen:32 | id:24. */
typedef struct {
    shmtf_word pose[SHMTF_POSE_WORDS];
    shmtf_word parent;
} shmtf_record_body;

typedef struct {
    shmtf_record_head head[1 << SHMTF_INLINE_LOG2];
    shmtf_record_body body[1 << SHMTF_INLINE_LOG2];
} shmtf_inline_ring;

_Static_assert(sizeof(shmtf_header) <= SHMTF_PAGE, "header fits its page");
_Static_assert(offsetof(shmtf_header, format) == 8 && offsetof(shmtf_header, max_frames) == 64, "header");
_Static_assert(sizeof(shmtf_global) == 128 && offsetof(shmtf_global, topology) == 64, "global");
_Static_assert(sizeof(shmtf_writer) == 192 && offsetof(shmtf_writer, pid) == 64, "writer");
_Static_assert(sizeof(shmtf_authority) == 128, "authority");
_Static_assert(sizeof(shmtf_bucket) == 64 && offsetof(shmtf_bucket, floor) == 56, "bucket");
_Static_assert(sizeof(shmtf_frame_words_t) == 256, "frame");
_Static_assert(offsetof(shmtf_frame_words_t, newest) == 64 && offsetof(shmtf_frame_words_t, head) == 192, "a frame's lines");
_Static_assert(sizeof(shmtf_name_t) == 128, "name");
_Static_assert(sizeof(shmtf_record_head) == 32 && offsetof(shmtf_record_head, info) == 24, "record head");
_Static_assert(sizeof(shmtf_record_body) == 64 && offsetof(shmtf_record_body, parent) == 56, "record body");
_Static_assert(sizeof(shmtf_inline_ring) == 384, "inline ring");

/* Sizes and places of one segment.  Computed, or read once from a header and checked; never read again. */
typedef struct {
    uint64_t max_frames, history, stream_bytes, max_writers;
    int64_t cache_time_ns; /* negative: nothing expires */
    uint64_t n_buckets, n_chunks, size_bytes;
    uint64_t off_writers, off_authorities, off_buckets, off_frames, off_names, off_inline, off_chunks, off_arena;
    uint32_t default_log2; /* ring size of frames that declare nothing */
} shmtf_geometry;

/* A segment bound to memory: any buffer of geometry.size_bytes, mapped or not. */
typedef struct {
    shmtf_geometry geo;
    shmtf_header *header;
    shmtf_global *global;
    shmtf_writer *writers;
    shmtf_authority *authorities;
    shmtf_bucket *buckets;
    shmtf_frame_words_t *frames;
    shmtf_name_t *names;
    shmtf_inline_ring *inlines;
    shmtf_word *chunks;
    unsigned char *arena;
    uint64_t arena_bytes;
    uint64_t ring_limit[32]; /* per log2 of a ring's size: offsets in the arena below this leave room for it */
} shmtf_segment;

/* Capacities to geometry.  Returns NULL, or the name of the argument that is out of range. */
const char *shmtf_layout_compute(shmtf_geometry *geo, uint64_t max_frames, uint64_t history, int64_t cache_time_ns,
                                 uint64_t stream_bytes, uint64_t max_writers);
/* Point a segment's parts into `base`. */
void shmtf_layout_bind(shmtf_segment *segment, const shmtf_geometry *geo, void *base);
/* Write a header and the initial words into zeroed memory; shmtf_layout_publish makes it a store. */
void shmtf_layout_format(shmtf_segment *segment, const uint64_t uuid[2], int64_t created_ns, uint64_t pid);
void shmtf_layout_publish(shmtf_segment *segment);

typedef enum { SHMTF_HEADER_OK, SHMTF_HEADER_NOT_READY, SHMTF_HEADER_FOREIGN, SHMTF_HEADER_BAD } shmtf_header_state;
/* Read a header once and check every number of it against what this build would compute.  *why names the word. */
shmtf_header_state shmtf_layout_read(const void *base, uint64_t size_bytes, shmtf_geometry *geo, const char **why);
/* Hash of every offset, size and limit above: segments with another fingerprint are refused. */
uint64_t shmtf_layout_fingerprint(void);

typedef struct {
    const char *record, *field;
    uint32_t offset, size;
    const char *rule; /* who writes it, under what; who may read it raw */
} shmtf_field;
/* The compiler's own account of the structs above. */
const shmtf_field *shmtf_layout_fields(size_t *n);

/* Bytes of a ring of 2^log2 records of `body_bytes`: heads, bodies, two order indexes. */
static inline uint64_t shmtf_ring_bytes(unsigned log2, uint64_t body_bytes) {
    return (sizeof(shmtf_record_head) + body_bytes + 2 * sizeof(uint32_t)) << log2;
}
/* Slots that hold no readable record: the most that one transaction may write into the ring. */
static inline uint64_t shmtf_ring_spare(unsigned log2) {
    uint64_t k = (1ull << log2) / 16;
    return k < 2 ? 2 : k;
}
static inline uint64_t shmtf_ring_live(unsigned log2) { return (1ull << log2) - shmtf_ring_spare(log2); }
/* The smallest ring that keeps `history` records; 0 if there is none. */
unsigned shmtf_ring_log2_for(uint64_t history);

#endif
