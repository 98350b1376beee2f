/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "segment/peer.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "segment/atomic.h"
#include "segment/guard.h"

/* Lock bytes need not exist as data; far behind the end no other tool's range lock is in the way. */
#define SLOT_OFFSET ((off_t)1 << 40)
#define CREATION_OFFSET (SLOT_OFFSET - 1)
enum { ANCHOR_BYTES = 4096 };

static pthread_mutex_t fork_mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_once_t fork_once = PTHREAD_ONCE_INIT;
static local_hint fork_count;

/* This mutex first: who claims a slot maps under it. */
static void before_fork(void) {
    pthread_mutex_lock(&fork_mutex);
    guard_before_fork();
}
static void after_fork(void) {
    guard_after_fork(false);
    pthread_mutex_unlock(&fork_mutex);
}
static void after_fork_child(void) {
    guard_after_fork(true);
    hint_set(&fork_count, hint_get(&fork_count) + 1);
    pthread_mutex_unlock(&fork_mutex);
}
static void install_guard(void) { pthread_atfork(before_fork, after_fork, after_fork_child); }

void peer_fork_guard(void) { pthread_once(&fork_once, install_guard); }
unsigned peer_fork_count(void) { return hint_get(&fork_count); }
void peer_fork_lock(void) { pthread_mutex_lock(&fork_mutex); }
void peer_fork_unlock(void) { pthread_mutex_unlock(&fork_mutex); }

static int byte_lock(int fd, int command, off_t at, struct flock *l) {
    int r;
    memset(l, 0, sizeof *l);
    l->l_type = F_WRLCK;
    l->l_whence = SEEK_SET;
    l->l_start = at;
    l->l_len = 1;
    do r = fcntl(fd, command, l);
    while (r < 0 && errno == EINTR);
    return r < 0 ? errno : 0;
}

static bool byte_held(int fd, off_t at) {
    struct flock l;
    return byte_lock(fd, F_OFD_GETLK, at, &l) != 0 || l.l_type != F_UNLCK;
}

static int claim_on(int fd, unsigned n_slots, unsigned hint, unsigned *slot, void **anchor) {
    struct flock l;
    for (unsigned i = 0; i < n_slots; i++) {
        *slot = (hint + i) % n_slots;
        int e = byte_lock(fd, F_OFD_SETLK, SLOT_OFFSET + *slot, &l);
        if (e == EAGAIN || e == EACCES) continue;
        return e ? e : map_memory(fd, ANCHOR_BYTES, 0, NULL, anchor);
    }
    return EAGAIN;
}

int peer_claim(int fd, unsigned n_slots, unsigned hint, unsigned *slot, void **anchor) {
    int own;
    peer_fork_lock(); /* a child forked between open and close would hold the claim for as long as it lives */
    int e = map_reopen(fd, 1, &own);
    if (!e) {
        e = claim_on(own, n_slots, hint, slot, anchor);
        /* Where the file system lies about locks, refuse to write rather than rob the living. */
        if (!e && !byte_held(fd, SLOT_OFFSET + *slot)) {
            peer_release(*anchor);
            e = ENOLCK;
        }
        close(own);
    }
    peer_fork_unlock();
    return e;
}

void peer_release(void *anchor) { map_release(anchor, ANCHOR_BYTES); }

bool peer_alive(int fd, const map_file *file, unsigned slot) {
    map_file now;
    if (byte_held(fd, SLOT_OFFSET + slot)) return true; /* the kernel's answer is ordered before what follows [E10 seq_cst] */
    return map_stat(fd, &now) || now.dev != file->dev || now.ino != file->ino;
}

int peer_hold_creation(int fd) {
    struct flock l;
    return byte_lock(fd, F_OFD_SETLK, CREATION_OFFSET, &l);
}

bool peer_creator_alive(int fd) { return byte_held(fd, CREATION_OFFSET); }
