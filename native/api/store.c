/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "api/store.h"

#include <errno.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/recover.h"

static void put_text(shmtf_word *words, const char *text) {
    uint64_t copy[SHMTF_TEXT_WORDS] = {0};
    size_t n = strlen(text);
    memcpy(copy, text, n < SHMTF_HOLDER_SIZE - 1 ? n : SHMTF_HOLDER_SIZE - 1);
    for (int i = 0; i < SHMTF_TEXT_WORDS; i++) store_relaxed(&words[i], copy[i]);
}

static shmtf_status map_segment(shmtf_store *h, const shmtf_geometry *geo, shmtf_error *e) {
    int fd = h->query_fd, err = h->readonly ? 0 : map_reopen(h->query_fd, 1, &fd);
    if (!err) err = map_memory(fd, geo->size_bytes, !h->readonly, &h->entry, &h->base);
    if (fd != h->query_fd && fd >= 0) close(fd);
    if (err) return error_system(e, SHMTF_SYSTEM, err, "mapping the store", NULL);
    shmtf_layout_bind(&h->s, geo, h->base);
    return SHMTF_OK;
}

static shmtf_status check_header(shmtf_store *h, shmtf_geometry *geo, shmtf_error *e) {
    void *page;
    const char *why;
    const uint64_t size = h->file.size_bytes;
    if (size < SHMTF_PAGE) {
        if (size == 0 && peer_creator_alive(h->query_fd)) return error_set(e, SHMTF_NOT_READY, "its creator is making it", NULL);
        return error_set(e, SHMTF_VERSION, "too small to be a store", "remove it, if nothing else uses it");
    }
    int err = map_memory(h->query_fd, SHMTF_PAGE, 0, NULL, &page);
    if (err) return error_system(e, SHMTF_SYSTEM, err, "mapping the header", NULL);
    shmtf_header_state state = shmtf_layout_read(page, size, geo, &why);
    const shmtf_header *header = page;
    h->uuid[0] = load_relaxed(&header->uuid[0]);
    h->uuid[1] = load_relaxed(&header->uuid[1]);
    map_release(page, SHMTF_PAGE);
    switch (state) {
    case SHMTF_HEADER_OK: return SHMTF_OK;
    case SHMTF_HEADER_FOREIGN: return error_set(e, SHMTF_VERSION, why, "made by another version, or not a store");
    case SHMTF_HEADER_BAD: return error_set(e, SHMTF_CORRUPT, why, "remove it and create it again");
    default: break;
    }
    if (peer_creator_alive(h->query_fd)) return error_set(e, SHMTF_NOT_READY, "its creator is making it", NULL);
    return error_set(e, SHMTF_CORRUPT, "abandoned by its creator half-way", "remove it and create it again");
}

static shmtf_status open_file(shmtf_store *h, int fd, shmtf_error *e) {
    int err = map_reopen(fd, 0, &h->query_fd);
    if (!err) err = map_stat(h->query_fd, &h->file);
    if (err && h->query_fd >= 0) {
        close(h->query_fd);
        h->query_fd = -1;
    }
    if (err == ENODEV) return error_system(e, SHMTF_VERSION, err, "not a regular file in shared memory (tmpfs)", NULL);
    if (err) return error_system(e, SHMTF_SYSTEM, err, "opening the store", NULL);
    return SHMTF_OK;
}

static shmtf_status attach(shmtf_store *h, int fd, shmtf_error *e) {
    shmtf_geometry geo;
    shmtf_status st = open_file(h, fd, e);
    if (st == SHMTF_OK) st = check_header(h, &geo, e);
    if (st == SHMTF_OK) st = map_segment(h, &geo, e);
    if (st != SHMTF_OK) return st;
    h->depth = calloc(geo.max_frames + 1, sizeof *h->depth);
    h->above = calloc(geo.max_frames + 1, sizeof *h->above);
    h->checked = h->readonly ? NULL : calloc(geo.max_frames + 1, sizeof *h->checked);
    if (!h->depth || !h->above || (!h->readonly && !h->checked)) return error_system(e, SHMTF_SYSTEM, ENOMEM, "process memory", NULL);
    return SHMTF_OK;
}

shmtf_status shmtf_attach_fd(int fd, unsigned flags, const char *writer, shmtf_store **store, shmtf_error *error) {
    error_clear(error);
    *store = NULL;
    peer_fork_guard();
    shmtf_store *h = calloc(1, sizeof *h);
    if (!h) return error_system(error, SHMTF_SYSTEM, ENOMEM, "process memory", NULL);
    h->query_fd = -1;
    flag_put(&h->authority, -1);
    h->readonly = (flags & SHMTF_READONLY) != 0;
    hint_set(&h->entry, h->forks = peer_fork_count());
    pthread_mutex_init(&h->mutex, NULL);
    const char *name = writer ? writer : program_invocation_short_name;
    memcpy(h->writer, name, strnlen(name, SHMTF_HOLDER_SIZE - 1));
    shmtf_status st = attach(h, fd, error);
    if (st != SHMTF_OK) {
        shmtf_close(h);
        return st;
    }
    *store = h;
    return SHMTF_OK;
}

static void free_context(write_context *c) {
    if (!c) return;
    free(c->x.entries);
    free(c->x.parents);
    free(c->x.entry_of);
    free(c->x.mark);
    free(c->order);
    free(c);
}

static void drop_contexts(shmtf_store *h, bool mapped) {
    for (int i = 0; i < MAX_CONTEXTS; i++) {
        if (mapped && h->contexts[i]) peer_release(h->contexts[i]->anchor);
        free_context(h->contexts[i]);
        h->contexts[i] = NULL;
    }
    flag_give(&h->n_contexts);
}

/* Is the descriptor that of another file?  Its number may have been closed, and taken by somebody else, whose it is then. */
static bool is_stolen(int fd, const map_file *file) {
    map_file now;
    int err = map_stat(fd, &now);
    return err ? err == ENODEV || err == EBADF : now.dev != file->dev || now.ino != file->ino;
}

void shmtf_close(shmtf_store *h) {
    if (!h) return;
    map_file now;
    bool mapped = h->forks == peer_fork_count(); /* in a forked child nothing of it is */
    drop_contexts(h, mapped);
    bool ours = h->query_fd >= 0 && !is_stolen(h->query_fd, &h->file);
    if (mapped && ours && !map_stat(h->query_fd, &now) && now.size_bytes < h->s.geo.size_bytes)
        bell_remove(h->uuid); /* with the file went the uuid, so nobody else can say which bell is without a store now */
    if (mapped) {
        bell_close(h->bell_map);
        map_release(h->base, h->s.geo.size_bytes);
    }
    if (ours) close(h->query_fd);
    pthread_mutex_destroy(&h->mutex);
    free(h->depth);
    free(h->above);
    free(h->checked);
    free(h);
}

shmtf_status store_lost(shmtf_error *e) {
    error_clear(e);
    return error_set(e, SHMTF_CORRUPT, "its file was cut short while it was mapped", "create the store again, and attach anew");
}

shmtf_status store_enter_slowly(shmtf_store *h, shmtf_error *e) {
    shmtf_status st = SHMTF_OK;
    if (hint_get(&h->entry) == GUARD_LOST) return store_lost(e);
    peer_fork_lock(); /* several threads of the child may come first */
    if (h->forks != peer_fork_count()) {
        shmtf_geometry geo = h->s.geo;
        if (is_stolen(h->query_fd, &h->file))
            st = error_set(e, SHMTF_CLOSED, "the descriptor inherited over fork was closed", "attach again in the child");
        else st = map_segment(h, &geo, e);
        if (st == SHMTF_OK) {
            pthread_mutex_init(&h->mutex, NULL); /* a thread that did not come along may have held it */
            drop_contexts(h, false);
            h->bell_map = NULL;
            h->bell_retry_ns = 0;
            flag_give(&h->has_bell);
            uint32_t before = h->forks;
            h->forks = peer_fork_count();
            if (!hint_change(&h->entry, before, h->forks)) st = store_lost(e); /* already: keep the mark */
        }
    }
    peer_fork_unlock();
    return st;
}

enum { BELL_RETRY_NS = 1000000000 };

bell *store_bell(shmtf_store *h) {
    pthread_mutex_lock(&h->mutex);
    if (!h->bell_map && clock_monotonic_ns() >= h->bell_retry_ns) {
        map_file now = h->file;
        map_stat(h->query_fd, &now); /* by now its name may be gone: then no new bell is made for it */
        h->bell_map = bell_open(h->uuid, &now);
        /* And by now?  Whoever removes a store removes its name before its bell, so one of us sees the other's work. */
        if (h->bell_map && now.links && !map_stat(h->query_fd, &now) && now.ino == h->file.ino && now.dev == h->file.dev && !now.links)
            bell_remove(h->uuid);
        h->bell_retry_ns = clock_monotonic_ns() + BELL_RETRY_NS;
        flag_put(&h->has_bell, h->bell_map != NULL);
    }
    bell *b = h->bell_map;
    pthread_mutex_unlock(&h->mutex);
    return b;
}

static bool make_workspace(shmtf_store *h, write_context *c) {
    size_t n = h->s.geo.max_frames + 1;
    c->x.s = &h->s;
    c->x.checked = h->checked;
    c->x.entries = calloc(n, sizeof *c->x.entries);
    c->x.parents = calloc(n, sizeof *c->x.parents);
    c->x.entry_of = calloc(n, sizeof *c->x.entry_of);
    c->x.mark = calloc(n, sizeof *c->x.mark);
    return c->x.entries && c->x.parents && c->x.entry_of && c->x.mark;
}

static shmtf_status claim_slot(shmtf_store *h, write_context *c, shmtf_error *e) {
    unsigned n = (unsigned)h->s.geo.max_writers;
    int err = peer_claim(h->query_fd, n, 0, &c->x.slot, &c->anchor);
    if (err == EAGAIN) {
        if (error_open(e)) e->limit = e->needed = n, e->needed++;
        return error_set(e, SHMTF_FULL, "max_writers", "create the store with a larger max_writers");
    }
    if (err == ENOLCK) return error_system(e, SHMTF_SYSTEM, err, "this file system does not keep locks; attach read-only", NULL);
    if (err) return error_system(e, SHMTF_SYSTEM, err, "claiming a writer slot", NULL);
    shmtf_writer *w = &h->s.writers[c->x.slot];
    c->x.live_from = recover_adopt(&h->s, c->x.slot);
    store_relaxed(&w->pid, (uint64_t)getpid());
    store_relaxed(&w->start_ns, (uint64_t)clock_realtime_ns());
    put_text(w->text, h->writer);
    c->random = (uint64_t)clock_monotonic_ns() ^ (uint64_t)getpid() << 32 ^ c->x.slot;
    return SHMTF_OK;
}

static shmtf_status make_context(shmtf_store *h, write_context **out, shmtf_error *e) {
    int n = flag_get(&h->n_contexts);
    if (n >= MAX_CONTEXTS) return error_set(e, SHMTF_FULL, "threads of one handle that write at once", "attach another handle");
    write_context *c = calloc(1, sizeof *c);
    shmtf_status st = c && make_workspace(h, c) ? claim_slot(h, c, e) : error_system(e, SHMTF_SYSTEM, ENOMEM, "process memory", NULL);
    if (st != SHMTF_OK) {
        free_context(c);
        return st;
    }
    flag_take(&c->taken);
    h->contexts[n] = c;
    flag_put(&h->n_contexts, n + 1);
    *out = c;
    return SHMTF_OK;
}

static bool take_idle(shmtf_store *h, write_context **c) {
    int n = flag_get(&h->n_contexts);
    for (int i = 0; i < n; i++)
        if (flag_take(&h->contexts[i]->taken)) return *c = h->contexts[i], true;
    return false;
}

shmtf_status store_take(shmtf_store *h, write_context **c, shmtf_error *e) {
    if (take_idle(h, c)) return SHMTF_OK;
    pthread_mutex_lock(&h->mutex);
    shmtf_status st = take_idle(h, c) ? SHMTF_OK : make_context(h, c, e);
    pthread_mutex_unlock(&h->mutex);
    return st;
}

void store_lose(shmtf_store *h, write_context *c) {
    pthread_mutex_lock(&h->mutex);
    peer_release(c->anchor);
    c->anchor = NULL;
    if (claim_slot(h, c, NULL) != SHMTF_OK) c->x.live_from = 0; /* live_from is at least 1: lost again next time */
    pthread_mutex_unlock(&h->mutex);
}

enum { CLAIM_WRITING = 1, CLAIM_READY = 2 };

static uint64_t text_hash(const char *text) {
    uint64_t h = 0xcbf29ce484222325ull;
    for (; *text; text++) h = (h ^ (unsigned char)*text) * 0x100000001b3ull;
    return h & ~3ull;
}

/* Texts are only added.  A writer that dies while adding one loses an entry; two may add the same: both are right. */
static uint16_t intern(const shmtf_segment *s, const char *name) {
    uint64_t hash = text_hash(name);
    for (uint16_t i = 0; i < SHMTF_N_AUTHORITIES; i++) {
        shmtf_authority *a = &s->authorities[i];
        uint64_t claim = load_acquire(&a->claim); /* [E11 acquire] */
        char text[SHMTF_HOLDER_SIZE];
        if (claim == (hash | CLAIM_READY)) {
            store_text(a->text, text);
            if (!strncmp(text, name, SHMTF_HOLDER_SIZE - 1)) return i;
        }
        if (claim || !cas_acq_rel(&a->claim, 0, hash | CLAIM_WRITING)) continue;
        put_text(a->text, name);
        store_release(&a->claim, hash | CLAIM_READY); /* [E11 release] */
        return i;
    }
    return SHMTF_N_AUTHORITIES; /* no room: unknown */
}

uint16_t store_authority(shmtf_store *h, const char *name) {
    if (name) return intern(&h->s, name);
    if (flag_get(&h->authority) < 0) flag_put(&h->authority, intern(&h->s, h->writer));
    return (uint16_t)flag_get(&h->authority);
}

shmtf_status shmtf_authority_name(shmtf_store *store, uint16_t writer, char name[SHMTF_HOLDER_SIZE]) {
    name[0] = 0;
    shmtf_status st = store_enter(store, NULL);
    if (st != SHMTF_OK || writer >= SHMTF_N_AUTHORITIES) return st;
    const shmtf_authority *a = &store->s.authorities[writer];
    if (load_acquire(&a->claim) & CLAIM_READY) store_text(a->text, name); /* [E11 acquire] */
    return store_leave(store, SHMTF_OK, NULL);
}
