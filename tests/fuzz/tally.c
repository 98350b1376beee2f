/* SPDX-License-Identifier: Apache-2.0
 *
 * What a run did, as one line of JSON; and the start under libFuzzer, which brings its own main and its own watchdog.
 */
#include <stdio.h>
#include <stdlib.h>

#include "fuzz.h"

fuzz_tally tally;

static void print_counts(const char *what, const uint64_t counts[32]) {
    const char *comma = "";
    printf(", \"%s\": {", what);
    for (int st = 0; st < 32; st++) {
        if (!counts[st]) continue;
        printf("%s\"%s\": %llu", comma, shmtf_status_name((shmtf_status)st), (unsigned long long)counts[st]);
        comma = ", ";
    }
    printf("}");
}

void tally_print(void) {
    unsigned n;
    images_all(&n);
    printf("{\"target\": \"%s\", \"images\": %u, \"inputs\": %llu, \"attached\": %llu", fuzz_target, n,
           (unsigned long long)tally.inputs, (unsigned long long)tally.attached);
    print_counts("refused", tally.refused);
    print_counts("answers", tally.answers);
    printf(", \"disturbed\": %llu, \"most_steps\": %llu, \"most_in\": \"%s\", \"bound\": %llu}\n", (unsigned long long)tally.disturbed,
           (unsigned long long)tally.most_steps, tally.most_in ? tally.most_in : "", (unsigned long long)tally.bound);
    fflush(stdout);
}

int LLVMFuzzerInitialize(int *argc, char ***argv);
int LLVMFuzzerInitialize(int *argc, char ***argv) {
    (void)argc;
    (void)argv;
    atexit(tally_print);
    return 0;
}
