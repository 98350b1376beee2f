/* SPDX-License-Identifier: Apache-2.0
 *
 * The only file that spells an atomic.  Every word of the segment that may change while another process looks at it
 * is a shmtf_word, read and written through the functions below; the suffix is the memory order.
 *
 * STEP hooks: with SHMTF_STEPS defined each shared access calls shmtf_step() with its address first, so that a test can count
 * the stores of an operation, die or stop before the k-th, or hand control to a scheduler.  Shipped builds have none.
 * tests/prove verifies that no byte of a segment or of its bell changes without a step that names its word.
 */
#ifndef SHMTF_SEGMENT_ATOMIC_H
#define SHMTF_SEGMENT_ATOMIC_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

/* For the few functions that every record of a lookup goes through. */
#define HOT_INLINE static inline __attribute__((always_inline))

typedef _Atomic uint64_t shmtf_word;
typedef _Atomic uint32_t shmtf_word32; /* futex words */

_Static_assert(sizeof(shmtf_word) == 8 && ATOMIC_LLONG_LOCK_FREE == 2, "64-bit lock-free atomics are required");

/* ThreadSanitizer does not see into assembly. */
#if defined(__SANITIZE_THREAD__)
#define SHMTF_SEES_ATOMICS_ONLY
#elif defined(__has_feature)
#if __has_feature(thread_sanitizer)
#define SHMTF_SEES_ATOMICS_ONLY
#endif
#endif

enum { SHMTF_STEP_LOAD, SHMTF_STEP_STORE };
#ifdef SHMTF_STEPS
void shmtf_step(int kind, const void *word);
#else
#define shmtf_step(kind, word) ((void)0)
#endif

static inline uint64_t load_relaxed(const shmtf_word *w) {
    shmtf_step(SHMTF_STEP_LOAD, (const void *)w);
    return atomic_load_explicit(w, memory_order_relaxed);
}
/* A relaxed load of a word that holds a double's bits, straight into a floating-point register: compilers take the
 * detour through an integer register for atomics, which costs a port and three cycles per number. */
static inline double load_double(const shmtf_word *w) {
    shmtf_step(SHMTF_STEP_LOAD, (const void *)w);
    double d;
#if defined(__AVX__) && !defined(SHMTF_SEES_ATOMICS_ONLY)
    __asm__("vmovsd %1, %0" : "=x"(d) : "m"(*w));
#elif defined(__x86_64__) && !defined(SHMTF_SEES_ATOMICS_ONLY)
    __asm__("movsd %1, %0" : "=x"(d) : "m"(*w));
#elif defined(__aarch64__) && !defined(SHMTF_SEES_ATOMICS_ONLY)
    __asm__("ldr %d0, %1" : "=w"(d) : "m"(*w));
#else
    uint64_t u = atomic_load_explicit(w, memory_order_relaxed);
    __builtin_memcpy(&d, &u, sizeof d);
#endif
    return d;
}
static inline uint64_t load_acquire(const shmtf_word *w) {
    shmtf_step(SHMTF_STEP_LOAD, (const void *)w);
    return atomic_load_explicit(w, memory_order_acquire);
}
static inline uint64_t load_seq_cst(const shmtf_word *w) {
    shmtf_step(SHMTF_STEP_LOAD, (const void *)w);
    return atomic_load_explicit(w, memory_order_seq_cst);
}
static inline void store_relaxed(shmtf_word *w, uint64_t v) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    atomic_store_explicit(w, v, memory_order_relaxed);
}
/* Two neighbouring words from two neighbouring doubles: one store where the machine has it.  The pair is not one atomic
 * step, each word is. */
static inline void store_double_pair(shmtf_word *w, const double *from) {
#if defined(__x86_64__) && !defined(SHMTF_SEES_ATOMICS_ONLY) && !defined(SHMTF_STEPS)
    typedef struct __attribute__((may_alias)) {
        double d[2];
    } pair;
    typedef double vector __attribute__((vector_size(16)));
    vector v;
    __builtin_memcpy(&v, from, sizeof v);
    __asm__("movups %1, %0" : "=m"(*(pair *)(void *)w) : "x"(v));
#else
    uint64_t u[2];
    __builtin_memcpy(u, from, sizeof u);
    store_relaxed(w, u[0]);
    store_relaxed(w + 1, u[1]);
#endif
}
static inline void store_release(shmtf_word *w, uint64_t v) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    atomic_store_explicit(w, v, memory_order_release);
}
static inline bool cas_acq_rel(shmtf_word *w, uint64_t expected, uint64_t desired) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    return atomic_compare_exchange_strong_explicit(w, &expected, desired, memory_order_acq_rel, memory_order_acquire);
}
static inline bool cas_seq_cst(shmtf_word *w, uint64_t expected, uint64_t desired) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    return atomic_compare_exchange_strong_explicit(w, &expected, desired, memory_order_seq_cst, memory_order_acquire);
}
static inline uint64_t fetch_or_seq_cst(shmtf_word *w, uint64_t bits) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    return atomic_fetch_or_explicit(w, bits, memory_order_seq_cst);
}
static inline uint64_t fetch_and_acq_rel(shmtf_word *w, uint64_t bits) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    return atomic_fetch_and_explicit(w, bits, memory_order_acq_rel);
}
/* Raise a word to at least v. */
static inline void raise_to(shmtf_word *w, uint64_t v) {
    uint64_t old = load_acquire(w);
    while (old < v && !cas_acq_rel(w, old, v)) old = load_acquire(w);
}
static inline uint32_t load32_relaxed(const shmtf_word32 *w) {
    shmtf_step(SHMTF_STEP_LOAD, (const void *)w);
    return atomic_load_explicit(w, memory_order_relaxed);
}
static inline void store32_relaxed(shmtf_word32 *w, uint32_t v) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    atomic_store_explicit(w, v, memory_order_relaxed);
}
static inline uint32_t load32_acquire(const shmtf_word32 *w) {
    shmtf_step(SHMTF_STEP_LOAD, (const void *)w);
    return atomic_load_explicit(w, memory_order_acquire);
}
static inline void increment32(shmtf_word32 *w) {
    shmtf_step(SHMTF_STEP_STORE, (const void *)w);
    atomic_fetch_add_explicit(w, 1, memory_order_acq_rel);
}

static inline void fence_acquire(void) { atomic_thread_fence(memory_order_acquire); }
static inline void fence_release(void) { atomic_thread_fence(memory_order_release); }
static inline void fence_seq_cst(void) { atomic_thread_fence(memory_order_seq_cst); }

/* The same value, of which the compiler knows nothing: keeps a prediction from being replaced by what confirms it. */
static inline uint32_t opaque32(uint32_t v) {
    __asm__("" : "+r"(v));
    return v;
}

/* A hint to the core that this is a spin. */
static inline void cpu_relax(void) {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("isb");
#endif
}

/* Process-local: a hint, counter or flag shared by the threads of one handle. */
typedef _Atomic uint32_t local_hint;
typedef _Atomic uint64_t local_hint64;
static inline uint32_t hint_get(const local_hint *h) { return atomic_load_explicit(h, memory_order_relaxed); }
static inline void hint_set(local_hint *h, uint32_t v) { atomic_store_explicit(h, v, memory_order_relaxed); }
static inline uint32_t hint_get_acquire(const local_hint *h) { return atomic_load_explicit(h, memory_order_acquire); }
static inline bool hint_change(local_hint *h, uint32_t from, uint32_t to) { /* with release */
    return atomic_compare_exchange_strong_explicit(h, &from, to, memory_order_acq_rel, memory_order_relaxed);
}
static inline void hint_add(local_hint *h, uint32_t n) { atomic_fetch_add_explicit(h, n, memory_order_acq_rel); }
static inline uint64_t hint64_get(const local_hint64 *h) { return atomic_load_explicit(h, memory_order_relaxed); }
static inline void hint64_set(local_hint64 *h, uint64_t v) { atomic_store_explicit(h, v, memory_order_relaxed); }
typedef atomic_uint_fast64_t local_count;
typedef atomic_int local_flag;
static inline void count_add(local_count *c, uint64_t n) {
    /* a lost increment under contention is acceptable, a locked instruction per lookup is not */
    atomic_store_explicit(c, atomic_load_explicit(c, memory_order_relaxed) + n, memory_order_relaxed);
}
static inline uint64_t count_get(local_count *c) { return atomic_load_explicit(c, memory_order_relaxed); }
static inline bool flag_take(local_flag *f) { return atomic_exchange_explicit(f, 1, memory_order_acquire) == 0; }
static inline void flag_give(local_flag *f) { atomic_store_explicit(f, 0, memory_order_release); }
static inline void flag_put(local_flag *f, int v) { atomic_store_explicit(f, v, memory_order_release); }
static inline int flag_get(local_flag *f) { return atomic_load_explicit(f, memory_order_acquire); }

#endif
