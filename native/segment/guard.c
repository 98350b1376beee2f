/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "segment/guard.h"

#include <errno.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { BLOCK = 64 };

/* Changed under `mutex`, read by the handler at any moment: `live` is set last and taken back first, and a range that is not
 * live changes only when no handler runs that may have seen it so. */
typedef struct {
    local_flag live;
    local_hint64 start, size;
    int writable;
    local_hint *mark;
} range;

typedef struct block {
    range range[BLOCK];
    struct block *next; /* never freed; read while `last` of the list says so */
} block;

static block first;
static local_hint n_blocks = 1;
static local_hint handling; /* threads that are in the handler, with a range that was live in their hands */
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_once_t once = PTHREAD_ONCE_INIT;
static struct sigaction previous;
static int install_error;

/* The n-th range, or NULL behind the last.  The handler calls it too. */
static range *range_at(size_t n) {
    block *b = &first;
    if (n >= (size_t)hint_get(&n_blocks) * BLOCK) return NULL;
    fence_acquire();
    for (; n >= BLOCK; n -= BLOCK) b = b->next;
    return &b->range[n];
}

static range *find(const void *base) {
    range *r;
    for (size_t i = 0; (r = range_at(i)); i++)
        if (flag_get(&r->live) && hint64_get(&r->start) == (uintptr_t)base) return r;
    return NULL;
}

static range *find_free(void) {
    range *r;
    size_t i = 0;
    while ((r = range_at(i)) && flag_get(&r->live)) i++;
    if (r) return r;
    block *last = &first, *more = calloc(1, sizeof *more);
    if (!more) return NULL;
    while (last->next) last = last->next;
    last->next = more;
    fence_release();
    hint_set(&n_blocks, hint_get(&n_blocks) + 1);
    return &more->range[0];
}

int guard_add(void *base, uint64_t size_bytes, int writable, local_hint *mark) {
    pthread_mutex_lock(&mutex);
    range *r = find_free();
    if (r) {
        hint64_set(&r->start, (uintptr_t)base);
        hint64_set(&r->size, size_bytes);
        r->writable = writable;
        r->mark = mark;
        flag_put(&r->live, 1);
    }
    pthread_mutex_unlock(&mutex);
    return r ? 0 : ENOMEM;
}

void guard_remove(const void *base) {
    pthread_mutex_lock(&mutex);
    range *r = find(base);
    if (r) flag_put(&r->live, 0);
    /* The place is about to be somebody else's, and so is the entry: a handler that saw it alive must be through. */
    fence_seq_cst();
    while (hint_get(&handling)) sched_yield();
    fence_acquire();
    pthread_mutex_unlock(&mutex);
}

void guard_before_fork(void) { pthread_mutex_lock(&mutex); }

void guard_after_fork(bool in_child) {
    range *r;
    for (size_t i = 0; in_child && (r = range_at(i)); i++) flag_put(&r->live, 0);
    if (in_child) hint_set(&handling, 0); /* those threads did not come along */
    pthread_mutex_unlock(&mutex);
}

/* ---- in the handler: system calls and the list only ---- */

static bool zero_out(const range *r) {
    void *base = (void *)(uintptr_t)hint64_get(&r->start);
    size_t size = hint64_get(&r->size);
    int protection = r->writable ? PROT_READ | PROT_WRITE : PROT_READ;
    if (r->mark) hint_set(r->mark, GUARD_LOST); /* before a zero can be seen */
    if (mmap(base, size, protection, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED | MAP_NORESERVE, -1, 0) == MAP_FAILED) return false;
    madvise(base, size, MADV_DONTFORK);
    madvise(base, size, MADV_DONTDUMP);
    return true;
}

static bool zero_out_at(uintptr_t address) {
    range *r;
    for (size_t i = 0; (r = range_at(i)); i++)
        if (flag_get(&r->live) && address - hint64_get(&r->start) < hint64_get(&r->size)) return zero_out(r);
    return false;
}

/* Can the end of the mapping be read?  The kernel copies the set before it finds that `how` is none. */
static bool is_lost(const range *r) {
    const void *end = (const void *)(uintptr_t)(hint64_get(&r->start) + hint64_get(&r->size) - sizeof(uint64_t));
    return syscall(SYS_rt_sigprocmask, ~0, end, NULL, sizeof(uint64_t)) && errno == EFAULT;
}

/* A handler above ours, such as Python's faulthandler, reports a fault and then raises the signal anew, without the address. */
static bool zero_out_all_lost(void) {
    range *r;
    bool any = false;
    for (size_t i = 0; (r = range_at(i)); i++)
        if (flag_get(&r->live) && is_lost(r)) any |= zero_out(r);
    return any;
}

static void pass_on(int number, siginfo_t *info, void *context) {
    bool sent = info->si_code <= 0;
    if (previous.sa_flags & SA_SIGINFO) {
        previous.sa_sigaction(number, info, context);
    } else if (previous.sa_handler == SIG_DFL || (previous.sa_handler == SIG_IGN && !sent)) {
        signal(number, SIG_DFL); /* an access is done again, and ends the process as it would have */
        if (sent) raise(number);
    } else if (previous.sa_handler != SIG_IGN) {
        previous.sa_handler(number);
    }
}

static void on_bus_error(int number, siginfo_t *info, void *context) {
    int saved = errno;
    bool done = false;
    hint_add(&handling, 1);
    fence_seq_cst();
    if (info->si_code == BUS_ADRERR) done = zero_out_at((uintptr_t)info->si_addr);
    else if (info->si_code <= 0 && info->si_pid == getpid()) done = zero_out_all_lost();
    hint_add(&handling, UINT32_MAX);
    if (!done) pass_on(number, info, context); /* may not come back */
    errno = saved;
}

static void install(void) {
    struct sigaction action = {.sa_sigaction = on_bus_error, .sa_flags = SA_SIGINFO | SA_ONSTACK};
    sigemptyset(&action.sa_mask);
    if (sigaction(SIGBUS, NULL, &previous) || sigaction(SIGBUS, &action, NULL)) install_error = errno;
}

int guard_install(void) {
    pthread_once(&once, install);
    return install_error;
}
