/* SPDX-License-Identifier: Apache-2.0
 *
 * shmtf: one robot's transform tree in one POSIX shared-memory segment.
 *
 * Every process maps the segment.  Writing is a few stores, reading is a few loads; a reader takes no lock,
 * writes nothing and never waits for a writer, so a read-only mapping is enough to read.
 *
 * Conventions
 *   direction   target first, then source.  A lookup returns T_target_source: p_target = T * p_source.
 *               A stored transform is T_parent_child, the pose of `child` in `parent`.
 *   units       metres; quaternions x y z w; stamps and durations are int64 nanoseconds.
 *   names       UTF-8, 1 to 127 bytes, no leading '/'.
 *   results     every function that can fail returns an shmtf_status; details go to the optional shmtf_error.
 *   threads     a handle may be used by any number of threads at once, except for shmtf_close.
 *   processes   any number may attach.  A process killed or stopped at any instruction delays no reader.
 *   fork        the child's first use of an inherited handle attaches anew by itself.
 *   signals     a function that waits returns SHMTF_INTERRUPTED when a signal handler ran; call it again.
 *   truncation  who truncates the file of a live store breaks it for all; see shmtf_guard_truncation.
 *   waiting     only functions with a `timeout_ns` may wait: 0 never waits, negative waits for ever.
 *               Deadlines are on CLOCK_MONOTONIC.
 */
#ifndef SHMTF_H
#define SHMTF_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define SHMTF_API __attribute__((visibility("default")))
#else
#define SHMTF_API
#endif

#define SHMTF_NAME_SIZE 128   /* bytes of a frame name, its terminating NUL included */
#define SHMTF_HOLDER_SIZE 96  /* bytes of a writer's name, its terminating NUL included */
#define SHMTF_FORMAT 1        /* version of the segment's layout */

typedef struct shmtf_store shmtf_store; /* an attached segment */

typedef enum shmtf_status {
    SHMTF_OK = 0,
    /* answers about the tree */
    SHMTF_LOOKUP,            /* a frame does not exist */
    SHMTF_CONNECTIVITY,      /* both exist, no path joins them */
    SHMTF_BACKWARD,          /* the time is before the oldest record of an edge */
    SHMTF_FORWARD,           /* the time is after the newest record of an edge */
    SHMTF_NO_DATA,           /* the edge has one record only, at another time */
    SHMTF_INVALID_ARGUMENT,
    SHMTF_CYCLE,             /* the new parent is a descendant of the frame */
    SHMTF_OLD_DATA,          /* more than cache_time behind the frame's newest record */
    /* answers about the store */
    SHMTF_EXISTS,
    SHMTF_NOT_FOUND,
    SHMTF_NOT_READY,         /* its creator is still making it */
    SHMTF_VERSION,           /* made by another version, or not a store */
    SHMTF_CORRUPT,           /* a word in the segment is impossible */
    SHMTF_FULL,              /* a capacity is exhausted; error.limit names it */
    SHMTF_READ_ONLY,
    SHMTF_BUSY,              /* another live writer holds a frame; error.holder names it */
    SHMTF_CONFLICT,          /* what a transaction read has changed */
    SHMTF_SNAPSHOT_EXPIRED,  /* the records of that commit were overwritten */
    SHMTF_CLOSED,
    SHMTF_TIMEOUT,           /* a wait ended without the event */
    SHMTF_INTERRUPTED,       /* a signal handler ran while waiting */
    SHMTF_SYSTEM             /* a system call failed; error.sys_errno says how */
} shmtf_status;

/* Why a call failed.  Only the fields that the status needs are set, the rest is zero. */
typedef struct shmtf_error {
    shmtf_status status;
    int sys_errno;
    const char *what;                   /* static text: the argument, word or limit concerned */
    const char *hint;                   /* static text: what would help, or NULL */
    char parent[SHMTF_NAME_SIZE];       /* the failing edge, or "" */
    char child[SHMTF_NAME_SIZE];        /* the failing edge or frame, or "" */
    int has_times;                      /* bit 0: requested, bit 1: oldest, bit 2: newest is set */
    int64_t requested_ns, oldest_ns, newest_ns;
    double value;                       /* the offending number, with INVALID_ARGUMENT */
    uint64_t limit, needed;             /* with FULL: the capacity and what was asked of it */
    size_t item;                        /* index of the offending transform in a batch */
    int holder_slot;                    /* with BUSY: the writer slot, or -1 */
    int64_t holder_pid;                 /* in the holder's own PID namespace: for people, not decisions */
    char holder[SHMTF_HOLDER_SIZE];
} shmtf_error;

/* Short English sentence for an error, NUL-terminated and cut to `size`.  Returns `buffer`. */
SHMTF_API char *shmtf_error_message(const shmtf_error *error, char *buffer, size_t size);
/* The status as a word, such as "BUSY". */
SHMTF_API const char *shmtf_status_name(shmtf_status status);
/* Version of the library, "MAJOR.MINOR.PATCH". */
SHMTF_API const char *shmtf_version(void);

/* ---- the segment ------------------------------------------------------------------------------------------- */

typedef struct shmtf_config {
    uint32_t max_frames;    /* names that can exist at once (default 1024) */
    uint32_t history;       /* records a frame keeps at least, unless declared otherwise (default 128) */
    int64_t cache_time_ns;  /* records this far behind a frame's newest expire; negative: never (default 10 s) */
    uint64_t stream_bytes;  /* memory for streams and larger histories beside the frames' own (default 8 MiB) */
    uint32_t max_writers;   /* threads of all processes that can write at once (default 128, at most 1023) */
} shmtf_config;

SHMTF_API void shmtf_config_default(shmtf_config *config);
/* Bytes of a segment with these capacities; 0 and an error if they are out of range. */
SHMTF_API uint64_t shmtf_segment_size(const shmtf_config *config, shmtf_error *error);

/* Lay an empty store into `fd`, an open, writable, empty file on tmpfs.  Memory is reserved now: FULL (with
 * sys_errno ENOSPC) instead of a SIGBUS later.  The store is valid when the call returns, never before. */
SHMTF_API shmtf_status shmtf_format_fd(int fd, const shmtf_config *config, shmtf_error *error);
/* Make a whole store and then give it its name, with these permission bits.  EXISTS if the name is taken.  A
 * creator that dies half-way leaves nothing. */
SHMTF_API shmtf_status shmtf_create(const char *name, const shmtf_config *config, unsigned mode, shmtf_error *error);

#define SHMTF_READONLY 1u /* map PROT_READ */

/* Map the store in `fd`; the descriptor stays the caller's.  `writer` names this process to people (may be NULL:
 * the program's name).  NOT_READY while its creator still works on it, VERSION or CORRUPT for anything else that
 * is no store of this format. */
SHMTF_API shmtf_status shmtf_attach_fd(int fd, unsigned flags, const char *writer, shmtf_store **store, shmtf_error *error);
/* Open by name and map.  Waits up to timeout_ns for the store to exist. */
SHMTF_API shmtf_status shmtf_attach(const char *name, unsigned flags, const char *writer, int64_t timeout_ns,
                                    shmtf_store **store, shmtf_error *error);
/* Remove the name.  Attached processes keep their mapping. */
SHMTF_API shmtf_status shmtf_unlink(const char *name, shmtf_error *error);
/* Remove the bell of the store open in `fd` (see native/README.md); for callers that unlink the name themselves. */
SHMTF_API shmtf_status shmtf_unlink_bell_fd(int fd, shmtf_error *error);
/* Survive it when somebody truncates a store's file: instead of ending the process by SIGBUS, calls on that store then
 * answer CORRUPT until it is closed.  Installs, once for the process, a handler of SIGBUS that passes whatever is not about
 * a store on to the handler that was there before; it stays, so the library must not be unloaded.  Install it after
 * handlers that end the process, such as faulthandler's: one that comes later is asked first.  No thread may block SIGBUS. */
SHMTF_API shmtf_status shmtf_guard_truncation(shmtf_error *error);
/* Unmap and free.  NULL is allowed.  No other thread may be using the handle. */
SHMTF_API void shmtf_close(shmtf_store *store);

typedef struct shmtf_info {
    shmtf_config config;
    uint64_t format, size_bytes, fingerprint, uuid[2];
    int64_t created_ns;      /* CLOCK_REALTIME */
    uint64_t version;        /* commits so far */
    uint32_t n_frames_bound; /* highest frame id ever used */
    uint64_t chunk_bytes, n_chunks, n_chunks_free;
    int readonly;
} shmtf_info;
SHMTF_API shmtf_status shmtf_get_info(shmtf_store *store, shmtf_info *info, shmtf_error *error);

/* What this handle did so far. */
typedef struct shmtf_counters {
    uint64_t commits, aborts, helps, recoveries, rereads, restarts, waits, late_dropped, repeats;
} shmtf_counters;
SHMTF_API void shmtf_get_counters(shmtf_store *store, shmtf_counters *counters);
/* Version of the last commit. */
SHMTF_API uint64_t shmtf_commit_version(shmtf_store *store);

/* ---- frames ------------------------------------------------------------------------------------------------ */

/* A resolved name.  It goes stale, never wrong, when the frame is removed.  gen 0: none. */
typedef struct shmtf_frame {
    uint32_t id, gen;
} shmtf_frame;

/* A frame by name or by handle: the handle counts where its gen is not 0. */
typedef struct shmtf_ref {
    const char *name;
    shmtf_frame frame;
} shmtf_ref;

static inline shmtf_ref shmtf_by_name(const char *name) {
    shmtf_ref r;
    r.name = name;
    r.frame.id = 0;
    r.frame.gen = 0;
    return r;
}
static inline shmtf_ref shmtf_by_handle(shmtf_frame frame) {
    shmtf_ref r;
    r.name = NULL;
    r.frame = frame;
    return r;
}

/* One commit of the whole tree, to be given to several reads.  Costs nothing, needs no release; when its records
 * are overwritten the reads answer SNAPSHOT_EXPIRED. */
typedef struct shmtf_snapshot {
    uint64_t word;
} shmtf_snapshot;
SHMTF_API shmtf_snapshot shmtf_take_snapshot(shmtf_store *store);
SHMTF_API uint64_t shmtf_snapshot_version(shmtf_snapshot snapshot);

/* In every read below `snapshot` may be NULL: the state at the moment of the call. */

/* Name to handle.  LOOKUP if no frame has that name. */
SHMTF_API shmtf_status shmtf_resolve(shmtf_store *store, const shmtf_snapshot *snapshot, const char *name,
                                     shmtf_frame *frame, shmtf_error *error);
/* Handle to name. */
SHMTF_API shmtf_status shmtf_frame_name(shmtf_store *store, shmtf_frame frame, char name[SHMTF_NAME_SIZE],
                                        shmtf_error *error);
/* All existing frames, by id.  Writes at most `max` and sets *n to how many there are. */
SHMTF_API shmtf_status shmtf_frames(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_frame *frames, size_t max,
                                    size_t *n, shmtf_error *error);

/* ---- write ------------------------------------------------------------------------------------------------- */

typedef struct shmtf_pose {
    double x, y, z, qx, qy, qz, qw;
} shmtf_pose;

#define SHMTF_STATIC 1u /* valid at every time; replaces whatever the frame held */

typedef struct shmtf_transform {
    shmtf_ref parent, child; /* in by name: `frame` is filled in, so that giving the item again skips the names */
    int64_t stamp_ns;
    shmtf_pose pose;         /* T_parent_child; |q| within 0.5 % of 1, stored normalised with qw >= 0 */
    uint32_t flags;
} shmtf_transform;

typedef struct shmtf_write_options {
    int64_t timeout_ns;    /* how long to contend for frames that others hold */
    int64_t arrival_ns;    /* CLOCK_REALTIME of this write; 0: now */
    const char *authority; /* who says so; NULL: the handle's writer name */
    int priority;          /* contending writers give way */
} shmtf_write_options;

/* Write all transforms or none, visible at one instant.  New frames and parents are made.  A record with a stamp
 * that its frame has already replaces it; late stamps are put in order.  Up to max(2, ring/16) records per frame.
 * version (optional): the commit.  options NULL: no waiting.
 * INVALID_ARGUMENT, CYCLE, OLD_DATA, FULL, READ_ONLY, BUSY: nothing was written; error.item says which. */
SHMTF_API shmtf_status shmtf_set_transforms(shmtf_store *store, shmtf_transform *transforms, size_t n,
                                            const shmtf_write_options *options, uint64_t *version, shmtf_error *error);
/* Give a frame a ring of its own size before its first record: at least `history` records. */
SHMTF_API shmtf_status shmtf_declare_frame(shmtf_store *store, const char *name, uint32_t history,
                                           const shmtf_write_options *options, shmtf_error *error);
/* End a frame: its name, id and memory may be used again.  Children stay, without a parent. */
SHMTF_API shmtf_status shmtf_remove_frame(shmtf_store *store, shmtf_ref frame, const shmtf_write_options *options,
                                          shmtf_error *error);
/* End all records, static ones too unless kept; names stay. */
SHMTF_API shmtf_status shmtf_clear(shmtf_store *store, int keep_static, const shmtf_write_options *options,
                                   shmtf_error *error);

/* ---- read -------------------------------------------------------------------------------------------------- */

typedef struct shmtf_edge {
    shmtf_frame parent, child;
    int64_t stamp_ns; /* of the record used; the older one where two were interpolated */
    int is_static;
} shmtf_edge;

typedef struct shmtf_result {
    shmtf_pose pose;              /* T_target_source */
    int64_t stamp_ns;             /* the asked or common time; for latest the oldest stamp used; 0 if all_static */
    int64_t oldest_ns, newest_ns; /* stamps used (at a time: that time) */
    int all_static;               /* the path has no dynamic edge: no stamp */
    uint64_t version;             /* the commit that was read */
    uint32_t n_edges;
    shmtf_edge *edges;            /* in: NULL or room for max_edges; filled source to target's ancestor, then target's side */
    uint32_t max_edges;
} shmtf_result;

/* The transform at *time_ns, interpolated (linear, and slerp); NULL: at the newest time common to every edge.
 * All edges are read at one commit.  result may be NULL (is it possible?), result->edges must be NULL or valid.
 * LOOKUP, CONNECTIVITY, BACKWARD, FORWARD, NO_DATA name the edge; with a timeout they are returned only after it. */
SHMTF_API shmtf_status shmtf_lookup_transform(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref target,
                                              shmtf_ref source, const int64_t *time_ns, int64_t timeout_ns,
                                              shmtf_result *result, shmtf_error *error);
/* The newest record (greatest stamp) of every edge, all at one commit.  Never extrapolates. */
SHMTF_API shmtf_status shmtf_lookup_latest_transform(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref target,
                                                     shmtf_ref source, int64_t timeout_ns, shmtf_result *result,
                                                     shmtf_error *error);
/* The newest time at which every edge between the two has data.  *has_time 0: all static, any time. */
SHMTF_API shmtf_status shmtf_latest_common_time(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref target,
                                                shmtf_ref source, int64_t *time_ns, int *has_time, shmtf_error *error);

typedef struct shmtf_record {
    int64_t stamp_ns, arrival_ns;
    uint64_t version;    /* the commit that wrote it */
    shmtf_frame parent;
    shmtf_pose pose;
    uint16_t writer;     /* for shmtf_authority_name */
    uint16_t epoch;      /* of the store's clock */
    int is_static;
} shmtf_record;

typedef struct shmtf_frame_info {
    shmtf_frame frame;
    char name[SHMTF_NAME_SIZE];
    shmtf_frame parent;             /* of the newest record; gen 0: a root */
    char parent_name[SHMTF_NAME_SIZE];
    int is_static, is_root;
    uint32_t n_records;             /* that can be read now */
    uint32_t capacity;              /* most that can be kept */
    int64_t oldest_ns, newest_ns;   /* valid where n_records > 0 and not static */
    int64_t arrival_ns;             /* of the newest record */
    uint64_t version;               /* commit of the newest record */
    uint16_t writer;
    uint64_t n_written;             /* records written in the ring's life */
    uint64_t generation;
} shmtf_frame_info;
SHMTF_API shmtf_status shmtf_get_frame_info(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref frame,
                                            shmtf_frame_info *info, shmtf_error *error);
/* Parent at a time (NULL: newest); parent->gen 0: a root then. */
SHMTF_API shmtf_status shmtf_parent(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref frame,
                                    const int64_t *time_ns, shmtf_frame *parent, shmtf_error *error);
/* Readable records, newest stamp first.  Writes at most `max` and sets *n to how many were written. */
SHMTF_API shmtf_status shmtf_records(shmtf_store *store, const shmtf_snapshot *snapshot, shmtf_ref frame,
                                     shmtf_record *records, size_t max, size_t *n, shmtf_error *error);
/* Text of a record's `writer`; "" if unknown. */
SHMTF_API shmtf_status shmtf_authority_name(shmtf_store *store, uint16_t writer, char name[SHMTF_HOLDER_SIZE]);

/* ---- wait -------------------------------------------------------------------------------------------------- */

/* Sleep in the kernel until a commit newer than `since` touches one of the frames (n = 0: any commit).  A frame
 * that does not exist yet counts as touched when it appears.  *version: the commit seen, the next `since`: nothing
 * in between is missed.  TIMEOUT leaves *version at the last commit looked at. */
SHMTF_API shmtf_status shmtf_wait_for_change(shmtf_store *store, const shmtf_ref *frames, size_t n, uint64_t since,
                                             int64_t timeout_ns, uint64_t *version, shmtf_error *error);

/* ---- inspect ----------------------------------------------------------------------------------------------- */

typedef struct shmtf_writer_info {
    int slot;
    int alive;            /* holds its kernel lock */
    int64_t pid, start_ns;
    char name[SHMTF_HOLDER_SIZE];
    uint64_t transaction; /* number of its last */
    int state;            /* 0 active, 1 prepared, 2 committed */
    uint64_t version;     /* with state 1 and 2 */
} shmtf_writer_info;
/* Slots in use, and those whose owner died since.  Writes at most `max`, sets *n to how many there are. */
SHMTF_API shmtf_status shmtf_writers(shmtf_store *store, shmtf_writer_info *writers, size_t max, size_t *n,
                                     shmtf_error *error);

typedef struct shmtf_frame_words {
    uint64_t lock, head, pending, newest_tag, commit; /* as they stand, unvalidated */
    int locked, owner_slot, owner_alive;
    uint64_t owner_transaction;
} shmtf_frame_words;
SHMTF_API shmtf_status shmtf_get_frame_words(shmtf_store *store, shmtf_ref frame, shmtf_frame_words *words,
                                             shmtf_error *error);

typedef struct shmtf_check_report {
    uint64_t frames, locks_held, locks_dead, locks_repaired, records, bad_words;
    char first_problem[160];
} shmtf_check_report;
/* Look at every word.  With `repair`, finish or undo what dead writers left; a corrupt segment is never edited:
 * CORRUPT, and nothing is changed. */
SHMTF_API shmtf_status shmtf_check(shmtf_store *store, int repair, shmtf_check_report *report, shmtf_error *error);

#ifdef __cplusplus
}
#endif
#endif
