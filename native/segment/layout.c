/* SPDX-License-Identifier: Apache-2.0 */
#include "segment/layout.h"

#include <string.h>

#define ROUND_UP(n, to) (((n) + (to) - 1) / (to) * (to))

unsigned shmtf_ring_log2_for(uint64_t history) {
    for (unsigned log2 = 3; log2 <= SHMTF_MAX_RING_LOG2; log2++)
        if (shmtf_ring_live(log2) >= history) return log2;
    return 0;
}

/* At least one bucket of seven hints for every two frames: a bucket hardly ever overflows. */
static uint64_t buckets_for(uint64_t max_frames) {
    uint64_t n = 16;
    while (n < max_frames / 2) n *= 2;
    return n;
}

const char *shmtf_layout_compute(shmtf_geometry *geo, uint64_t max_frames, uint64_t history, int64_t cache_time_ns,
                                 uint64_t stream_bytes, uint64_t max_writers) {
    if (max_frames < 1 || max_frames > SHMTF_MAX_FRAMES) return "max_frames";
    if (max_writers < 1 || max_writers > SHMTF_MAX_WRITERS) return "max_writers";
    if (stream_bytes > 1ull << 40) return "stream_bytes";
    unsigned log2 = history ? shmtf_ring_log2_for(history) : 0;
    if (!log2) return "history";
    memset(geo, 0, sizeof *geo);
    geo->max_frames = max_frames;
    geo->history = history;
    geo->cache_time_ns = cache_time_ns < 0 ? -1 : cache_time_ns;
    geo->stream_bytes = stream_bytes;
    geo->max_writers = max_writers;
    geo->default_log2 = log2;
    uint64_t ring = ROUND_UP(shmtf_ring_bytes(log2, sizeof(shmtf_record_body)), SHMTF_CHUNK_BYTES);
    uint64_t n = max_frames + 1;
    geo->n_buckets = buckets_for(max_frames);
    geo->n_chunks = (ring * max_frames + ROUND_UP(stream_bytes, SHMTF_CHUNK_BYTES)) / SHMTF_CHUNK_BYTES;
    if (geo->n_chunks >= 1ull << 32) return "history";
    uint64_t at = SHMTF_PAGE + sizeof(shmtf_global);
    geo->off_writers = at, at += max_writers * sizeof(shmtf_writer);
    geo->off_authorities = at, at += SHMTF_N_AUTHORITIES * sizeof(shmtf_authority);
    geo->off_buckets = at, at += geo->n_buckets * sizeof(shmtf_bucket);
    geo->off_frames = at = ROUND_UP(at, sizeof(shmtf_frame_words_t)), at += n * sizeof(shmtf_frame_words_t);
    geo->off_names = at, at += n * sizeof(shmtf_name_t);
    geo->off_inline = at, at += n * sizeof(shmtf_inline_ring);
    geo->off_chunks = at, at += geo->n_chunks * sizeof(shmtf_word);
    geo->off_arena = at = ROUND_UP(at, SHMTF_PAGE);
    geo->size_bytes = ROUND_UP(at + geo->n_chunks * SHMTF_CHUNK_BYTES, SHMTF_PAGE);
    return NULL;
}

void shmtf_layout_bind(shmtf_segment *s, const shmtf_geometry *geo, void *base) {
    unsigned char *b = base;
    s->geo = *geo;
    s->header = (shmtf_header *)(void *)b;
    s->global = (shmtf_global *)(void *)(b + SHMTF_PAGE);
    s->writers = (shmtf_writer *)(void *)(b + geo->off_writers);
    s->authorities = (shmtf_authority *)(void *)(b + geo->off_authorities);
    s->buckets = (shmtf_bucket *)(void *)(b + geo->off_buckets);
    s->frames = (shmtf_frame_words_t *)(void *)(b + geo->off_frames);
    s->names = (shmtf_name_t *)(void *)(b + geo->off_names);
    s->inlines = (shmtf_inline_ring *)(void *)(b + geo->off_inline);
    s->chunks = (shmtf_word *)(void *)(b + geo->off_chunks);
    s->arena = b + geo->off_arena;
    s->arena_bytes = geo->n_chunks * SHMTF_CHUNK_BYTES;
    for (unsigned log2 = 0; log2 < 32; log2++) {
        uint64_t size = shmtf_ring_bytes(log2, sizeof(shmtf_record_body));
        s->ring_limit[log2] = log2 >= 3 && log2 <= SHMTF_MAX_RING_LOG2 && size <= s->arena_bytes ? s->arena_bytes - size + 1 : 0;
    }
}

/* The header's numbers in the order of the struct, from max_frames on. */
static void numbers(const shmtf_geometry *g, uint64_t out[15]) {
    const uint64_t n[15] = {g->max_frames,  g->history,         g->cache_time_ns < 0 ? UINT64_MAX : (uint64_t)g->cache_time_ns,
                            g->stream_bytes, g->max_writers,    g->n_buckets,
                            g->n_chunks,    g->off_writers,     g->off_authorities,
                            g->off_buckets, g->off_frames,      g->off_names,
                            g->off_inline,  g->off_chunks,      g->off_arena};
    memcpy(out, n, sizeof n);
}

void shmtf_layout_format(shmtf_segment *s, const uint64_t uuid[2], int64_t created_ns, uint64_t pid) {
    shmtf_header *h = s->header;
    store_relaxed(&h->magic, SHMTF_MAGIC);
    store_relaxed(&h->fingerprint, shmtf_layout_fingerprint());
    store_relaxed(&h->size_bytes, s->geo.size_bytes);
    store_relaxed(&h->uuid[0], uuid[0]);
    store_relaxed(&h->uuid[1], uuid[1]);
    store_relaxed(&h->created_ns, (uint64_t)created_ns);
    store_relaxed(&h->creator_pid, pid);
    uint64_t n[15];
    numbers(&s->geo, n);
    for (int i = 0; i < 15; i++) store_relaxed(&h->max_frames + i, n[i]);
    for (uint64_t i = 0; i < s->geo.max_writers; i++) store_relaxed(&s->writers[i].live_from, 1);
    for (uint64_t i = 0; i <= s->geo.max_frames; i++) store_relaxed(&s->frames[i].gen, i == 0 ? 2 : 0);
    store_relaxed(&s->global->frame_hint, 1);
}

void shmtf_layout_publish(shmtf_segment *s) { store_release(&s->header->format, 1); /* [E1 release] */ }

shmtf_header_state shmtf_layout_read(const void *base, uint64_t size_bytes, shmtf_geometry *geo, const char **why) {
    const shmtf_header *h = base;
    *why = "magic";
    uint64_t format = load_acquire(&h->format); /* [E1 acquire] */
    uint64_t magic = load_relaxed(&h->magic);
    if (format == 0 && (magic == 0 || magic == SHMTF_MAGIC)) return SHMTF_HEADER_NOT_READY;
    if (magic != SHMTF_MAGIC) return SHMTF_HEADER_FOREIGN;
    *why = "format version";
    if (format != 1) return SHMTF_HEADER_FOREIGN;
    *why = "layout fingerprint";
    if (load_relaxed(&h->fingerprint) != shmtf_layout_fingerprint()) return SHMTF_HEADER_FOREIGN;
    uint64_t n[15], expected[15];
    for (int i = 0; i < 15; i++) n[i] = load_relaxed(&h->max_frames + i);
    *why = shmtf_layout_compute(geo, n[0], n[1], (int64_t)n[2], n[3], n[4]);
    if (*why) return SHMTF_HEADER_BAD;
    *why = "geometry";
    numbers(geo, expected);
    if (memcmp(n, expected, sizeof n)) return SHMTF_HEADER_BAD;
    *why = "size";
    if (geo->size_bytes != size_bytes || load_relaxed(&h->size_bytes) != size_bytes) return SHMTF_HEADER_BAD;
    *why = NULL;
    return SHMTF_HEADER_OK;
}

#define F(record, struct, field, rule) {record, #field, (uint32_t)offsetof(struct, field), (uint32_t)sizeof(((struct *)0)->field), rule}
static const shmtf_field fields[] = {
    F("header", shmtf_header, magic, "creator; constant"),
    F("header", shmtf_header, format, "creator, last of all (release); attach reads it first (acquire)"),
    F("header", shmtf_header, fingerprint, "creator; constant"),
    F("header", shmtf_header, size_bytes, "creator; constant"),
    F("header", shmtf_header, uuid, "creator; constant; names the bell"),
    F("header", shmtf_header, created_ns, "creator; constant; CLOCK_REALTIME"),
    F("header", shmtf_header, creator_pid, "creator; constant; for people"),
    F("header", shmtf_header, max_frames, "creator; constant"),
    F("header", shmtf_header, history, "creator; constant"),
    F("header", shmtf_header, cache_time_ns, "creator; constant; all ones: nothing expires"),
    F("header", shmtf_header, stream_bytes, "creator; constant"),
    F("header", shmtf_header, max_writers, "creator; constant"),
    F("header", shmtf_header, n_buckets, "creator; derived, checked at attach"),
    F("header", shmtf_header, n_chunks, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_writers, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_authorities, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_buckets, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_frames, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_names, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_inline, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_chunks, "creator; derived, checked at attach"),
    F("header", shmtf_header, off_arena, "creator; derived, checked at attach"),
    F("header", shmtf_header, time_namespace, "reserved, 0"),
    F("global", shmtf_global, commit, "any committer, CAS; readers load it first of all"),
    F("global", shmtf_global, topology, "committers and helpers, raised only"),
    F("global", shmtf_global, frame_hint, "any writer; a hint"),
    F("global", shmtf_global, chunk_hint, "any writer; a hint"),
    F("global", shmtf_global, frames_bound, "binders, raised only, before the frame's hint is published"),
    F("global", shmtf_global, reach, "binders, raised only, before the frame's hint is published"),
    F("writer", shmtf_writer, state, "the slot's owner; helpers PREPARED to COMMITTED by CAS"),
    F("writer", shmtf_writer, txn, "the slot's owner"),
    F("writer", shmtf_writer, live_from, "who adopts the slot"),
    F("writer", shmtf_writer, pid, "the slot's owner; for people"),
    F("writer", shmtf_writer, start_ns, "the slot's owner; for people"),
    F("writer", shmtf_writer, text, "the slot's owner; for people"),
    F("authority", shmtf_authority, claim, "whoever interns the text, CAS from 0"),
    F("authority", shmtf_authority, text, "whoever holds the claim"),
    F("bucket", shmtf_bucket, hint, "binders, CAS over 0 or garbage"),
    F("bucket", shmtf_bucket, floor, "binders, raised only"),
    F("frame", shmtf_frame_words_t, lock, "writers, CAS from free; the owner and helpers, CAS to free"),
    F("frame", shmtf_frame_words_t, gen, "binder, under lock"),
    F("frame", shmtf_frame_words_t, newest_tag, "the one not in force: the lock's owner; helpers by CAS from the owner's tag"),
    F("frame", shmtf_frame_words_t, newest_stamp, "the one not in force: the lock's owner"),
    F("frame", shmtf_frame_words_t, newest_edge, "the one not in force: the lock's owner"),
    F("frame", shmtf_frame_words_t, newest, "the one not in force: the lock's owner; seven words of pose, one unused"),
    F("frame", shmtf_frame_words_t, head, "the one not in force: the lock's owner"),
    F("frame", shmtf_frame_words_t, newest_search, "the one not in force: the lock's owner"),
    F("frame", shmtf_frame_words_t, ring, "binder or first dynamic writer, under lock, before it is in force"),
    F("frame", shmtf_frame_words_t, floor, "binder, under lock, raised only"),
    F("frame", shmtf_frame_words_t, want, "a waiting writer, CAS from 0; anybody, CAS to 0 from a dead or finished one, or one waited for in vain"),
    F("frame", shmtf_frame_words_t, first, "binder, under lock, once"),
    F("name", shmtf_name_t, word, "binder, under lock, gen odd"),
    F("record head", shmtf_record_head, tag, "lock's owner; helpers by CAS from the owner's tag"),
    F("record head", shmtf_record_head, stamp, "lock's owner, in a slot no head reaches"),
    F("record head", shmtf_record_head, arrival, "lock's owner, in a slot no head reaches"),
    F("record head", shmtf_record_head, info, "lock's owner, in a slot no head reaches"),
    F("record body", shmtf_record_body, pose, "lock's owner, in a slot no head reaches"),
    F("record body", shmtf_record_body, parent, "lock's owner, in a slot no head reaches"),
};
#undef F

const shmtf_field *shmtf_layout_fields(size_t *n) {
    *n = sizeof fields / sizeof *fields;
    return fields;
}

static uint64_t mix(uint64_t h, uint64_t v) { return (h ^ v) * 0x9e3779b97f4a7c15ull ^ (h >> 29); }

uint64_t shmtf_layout_fingerprint(void) {
    uint64_t h = SHMTF_MAGIC;
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++) h = mix(h, (uint64_t)fields[i].offset << 32 | fields[i].size);
    const uint64_t limits[] = {SHMTF_PAGE, SHMTF_CHUNK_BYTES, SHMTF_BUCKET_HINTS, SHMTF_N_AUTHORITIES, SHMTF_INLINE_LOG2,
                               sizeof(shmtf_global), sizeof(shmtf_writer), sizeof(shmtf_authority), 0x0102030405060708ull};
    for (size_t i = 0; i < sizeof limits / sizeof *limits; i++) h = mix(h, limits[i]);
    return h | 1;
}
