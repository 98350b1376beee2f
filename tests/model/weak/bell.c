/* SPDX-License-Identifier: Apache-2.0
 *
 * E9: a waiter announces itself and looks, a writer commits and looks: never does one sleep that the other does not wake.
 * The system calls are not there; a waiter that would sleep for good is one whose word is still what it saw.
 */
#include "scenario.h"

typedef unsigned long dev_t, ino_t, nlink_t; /* of headers that the checker does not have */
typedef unsigned uid_t, mode_t;
#include "segment/wait.h"

enum { FUTEX_WAKE };
static void futex(shmtf_word32 *word, int op, int n, void *unused) { (void)word, (void)op, (void)n, (void)unused; }
#undef INT_MAX
#define INT_MAX 0
#include "bell_part.c"

static bell rung;
static bool slept;
static uint32_t word_seen;

static void *waiter(void *unused) {
    (void)unused;
    const unsigned bucket = 5;
    bell_arm(&rung, &bucket, 1, &word_seen);
    slept = load_seq_cst(&global.commit) == 0; /* as in look_until_stable [E9 seq_cst] */
    return NULL;
}

static void *committer(void *unused) {
    (void)unused;
    bell_set touched = {{0}};
    bell_add(&touched, 5);
    cas_seq_cst(&global.commit, 0, commit_make(0, 1)); /* as in commit_once [E9 seq_cst] */
    if (bell_is_armed(&rung)) bell_ring(&rung, &touched);
    return NULL;
}

int main(void) {
    pthread_t t[2];
    pthread_create(&t[0], NULL, waiter, NULL);
    pthread_create(&t[1], NULL, committer, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    assert(!(slept && load32_acquire(&rung.word[5]) == word_seen));
    return 0;
}
