/* SPDX-License-Identifier: Apache-2.0
 *
 * For LD_PRELOAD: CLOCK_REALTIME can be stepped, all other clocks are the machine's. */
#include <stdatomic.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static atomic_llong offset_ns;

void clock_step(long long ns);
void clock_step(long long ns) { atomic_fetch_add(&offset_ns, ns); }

int clock_gettime(clockid_t clock, struct timespec *t) {
    int done = (int)syscall(SYS_clock_gettime, clock, t);
    if (done || clock != CLOCK_REALTIME) return done;
    long long ns = t->tv_sec * 1000000000ll + t->tv_nsec + atomic_load(&offset_ns);
    *t = (struct timespec){ns / 1000000000, ns % 1000000000};
    return 0;
}
