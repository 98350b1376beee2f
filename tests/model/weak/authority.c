/* SPDX-License-Identifier: Apache-2.0
 *
 * E11: an authority's text is read while it is being added: not ready yet, or whole.
 */
#include "scenario.h"

static void put_text(shmtf_word *words, const char *text) { store_relaxed(&words[0], (unsigned char)text[0]); }
static void store_text(const shmtf_word *words, char out[SHMTF_HOLDER_SIZE]) {
    out[0] = (char)load_relaxed(&words[0]);
    out[1] = 0;
}
static int strncmp_one(const char *a, const char *b) { return a[0] - b[0]; }
#define strncmp(a, b, n) strncmp_one(a, b)
#include "authority_part.c"

static shmtf_authority authorities[SHMTF_N_AUTHORITIES];

static void *adder(void *unused) {
    (void)unused;
    intern(&s, "a");
    return NULL;
}

static void *reader(void *unused) {
    (void)unused;
    char name[SHMTF_HOLDER_SIZE];
    if (load_acquire(&authorities[0].claim) & CLAIM_READY) { /* as in shmtf_authority_name [E11 acquire] */
        store_text(authorities[0].text, name);
        assert(name[0] == 'a');
    }
    return NULL;
}

int main(void) {
    pthread_t t[2];
    s.authorities = authorities;
    pthread_create(&t[0], NULL, adder, NULL);
    pthread_create(&t[1], NULL, reader, NULL);
    pthread_join(t[0], NULL);
    pthread_join(t[1], NULL);
    return 0;
}
