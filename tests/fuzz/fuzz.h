/* SPDX-License-Identifier: Apache-2.0
 *
 * Fuzzing a store: what the targets share.
 *
 * A target (fuzz_*.c) is one LLVMFuzzerTestOneInput.  An input is a string of bytes that are taken one after another as
 * decisions: which whole image to begin with, what to change in it, what to ask.  So an input is the same under libFuzzer,
 * and under driver.c, which makes inputs from a seed and needs nothing but a C compiler.
 *
 *   images.c   whole segments to begin with: rich trees, and what a writer leaves that dies at each named step
 *   mutate.c   changes that know what a word means
 *   watch.c    the rules: every access inside the mapping, no store by a read, a bound on accesses per call, and no answer
 *              that its function does not document
 *   calls.c    every read and every write, with arguments from the input
 *   rules.c    breaks each rule once and sees it noticed
 *
 * Tiers: test (a few thousand inputs per target by ctest, with AddressSanitizer in CI), on demand `tools/dev fuzz`.
 */
#ifndef SHMTF_TESTS_FUZZ_H
#define SHMTF_TESTS_FUZZ_H

#include "api/store.h"

/* ---- the input ---- */

/* Behind its end the decisions go on from a hash of the input. */
void take_from(const uint8_t *data, size_t size);
uint64_t take64(void);
/* 0 .. n-1. */
uint32_t take(uint32_t n);
static inline bool one_in(uint32_t n) { return take(n) == 0; }

/* ---- images ---- */

typedef struct {
    const char *what;
    unsigned world; /* images of one world have one geometry */
    uint64_t size;
    unsigned char *bytes;
} image;

enum { N_WORLDS = 2, N_NAMES = 20 };
extern char image_names[N_NAMES][8];
/* Made once a process. */
const image *images_all(unsigned *n);
/* Begin with this input, which first chooses one of them. */
const image *images_begin(const uint8_t *data, size_t size);
void image_geometry(unsigned world, shmtf_geometry *geo);
/* Called by watch.c at each named step while images are made. */
void images_failpoint(const char *name);

/* ---- changes ---- */

/* Some changes to the segment at `base`; seldom to the header. */
void mutate_some(unsigned char *base, const shmtf_geometry *geo);
/* One word: the one at `word` or, NULL, any behind the header. */
void mutate_word(unsigned char *base, const shmtf_geometry *geo, unsigned char *word);

/* ---- rules ---- */

typedef struct {
    uint64_t inputs, attached, refused[32], answers[32], most_steps, bound, disturbed;
    const char *most_in;
} fuzz_tally;
extern fuzz_tally tally;
void tally_print(void);
extern const char *const fuzz_target; /* by the target */

/* From here on: accesses belong to this store. */
void watch_store(const shmtf_store *h);
void watch_nothing(void);
typedef enum { CALL_READ, CALL_WRITE } call_kind;
void watch_call(const char *name, call_kind kind);
/* The call is over; its answer must be one that its kind may give. */
void watch_answer(shmtf_status status, const shmtf_error *error);
/* Before about one access in `period` a word is changed; 0: none. */
void watch_disturb(unsigned char *base, const shmtf_geometry *geo, uint32_t period);
/* Something is wrong: says so and ends the process. */
_Noreturn void watch_failed(const char *what);
/* Where the driver keeps what a report needs; and the watchdog and reports of a program that has none of its own. */
extern uint64_t watch_seed, watch_input;
void watch_init(void);

/* ---- calls ---- */

/* Every read once. */
void call_reads(shmtf_store *h);
void call_read(shmtf_store *h, unsigned which);
void call_write(shmtf_store *h);
void call_check(shmtf_store *h, int repair);
void call_waits(shmtf_store *h);

/* ---- the file under test ---- */

typedef struct {
    int fd;
    unsigned char *base;
    shmtf_store *peer; /* alive, and holds a writer slot; or NULL */
} bench;
/* An unnamed file with a whole image, changed.  with_peer: another handle of this process holds a slot of it. */
bench *bench_load(const image *i, bool with_peer);
/* Attach, and count how that went; NULL if it was refused. */
shmtf_store *bench_attach(int fd, unsigned flags);
/* A file whose size does not fit. */
int bench_odd_size(const image *i);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#endif
