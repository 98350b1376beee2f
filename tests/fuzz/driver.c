/* SPDX-License-Identifier: Apache-2.0
 *
 * Runs a target without libFuzzer: inputs made from a seed and a number.
 *
 * usage: fuzz_X [--seed S] [--from I] [--runs N] [--only I]
 * Input I of seed S is the same bytes everywhere.  The last line of the output is the tally, as JSON.
 */
#include "fuzz.h"

#include <stdlib.h>

enum { LONGEST = 2048 };

static uint64_t mix(uint64_t *state) { /* splitmix64 */
    uint64_t z = *state += 0x9e3779b97f4a7c15ull;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ z >> 27) * 0x94d049bb133111ebull;
    return z ^ z >> 31;
}

static void run_input(uint64_t seed, uint64_t number) {
    uint64_t state = seed * 0xd1342543de82ef95ull + number, words[LONGEST / 8];
    size_t n = 4 + mix(&state) % 12; /* what the input does not say follows from its hash */
    for (size_t i = 0; i < n; i++) words[i] = mix(&state);
    uint8_t *data = malloc(n * 8); /* exactly as long: reading behind its end is seen */
    if (!data) abort();
    memcpy(data, words, n * 8);
    watch_input = number;
    LLVMFuzzerTestOneInput(data, n * 8);
    free(data);
}

int main(int argc, char **argv) {
    uint64_t from = 0, runs = 1000;
    watch_seed = 1;
    for (int i = 1; i + 1 < argc; i += 2) {
        uint64_t v = strtoull(argv[i + 1], NULL, 0);
        if (!strcmp(argv[i], "--seed")) watch_seed = v;
        else if (!strcmp(argv[i], "--from")) from = v;
        else if (!strcmp(argv[i], "--runs")) runs = v;
        else if (!strcmp(argv[i], "--only")) from = v, runs = 1;
        else return 2;
    }
    watch_init();
    for (uint64_t i = from; i < from + runs; i++) run_input(watch_seed, i);
    tally_print();
    return 0;
}
