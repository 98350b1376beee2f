/* SPDX-License-Identifier: Apache-2.0
 *
 * usage: soak_member ROLE STORE SECOND_STORE BOARD CELL SEED
 *
 * One member of the long run, see ../soak.py: it does what its role says until the board says that it is over, or until
 * it is killed.  Exit code 3: a promise was broken, and the board says which.
 */
#define _GNU_SOURCE
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <signal.h>
#include <unistd.h>

#include "world.h"

static const struct {
    const char *name;
    void (*body)(member *m);
    unsigned flags;
} roles[] = {
    {"build", world_build, 0},
    {"singles", write_singles, 0},
    {"batches", write_batches, 0},
    {"big", write_big, 0},
    {"shape", change_shape, 0},
    {"clears", clear_second, 0},
    {"reader", read_everything, 0},
    {"readonly", read_everything, SHMTF_READONLY},
    {"second-reader", read_second, SHMTF_READONLY},
    {"waiter", wait_for_singles, 0},
    {"readonly-waiter", wait_for_singles, SHMTF_READONLY},
};

static shmtf_store *attach(const char *name, unsigned flags) {
    shmtf_store *h;
    shmtf_error e;
    if (shmtf_attach(name, flags, "soak", 0, &h, &e)) violation("attach", &e);
    return h;
}

int main(int argc, char **argv) {
    member m = {0};
    if (argc < 7 || prctl(PR_SET_PDEATHSIG, SIGKILL)) return 2;
    if (nice(5) == -1) return 2; /* who kills and stops comes first */
    board_open(argv[4], atoi(argv[5]));
    atomic_store(&cell->pid, getpid());
    m.random = strtoull(argv[6], NULL, 10) * 0x9e3779b97f4a7c15u | 1;
    world_names();
    for (size_t i = 0; i < sizeof roles / sizeof *roles; i++) {
        if (strcmp(argv[1], roles[i].name)) continue;
        m.main = attach(argv[2], roles[i].flags);
        m.second = attach(argv[3], roles[i].flags);
        roles[i].body(&m);
        shmtf_close(m.main);
        shmtf_close(m.second);
        return 0;
    }
    return 2;
}
