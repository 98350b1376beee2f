/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "control.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/futex.h>
#include <limits.h>
#include <math.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { SLICE_NS = 100000000 };

size_t bench_control_size(uint32_t n_workers) { return sizeof(bench_control) + n_workers * sizeof(bench_worker); }

int bench_control_make(uint32_t n_workers) {
    int fd = memfd_create("shmtf-bench-control", MFD_CLOEXEC);
    if (fd < 0) return -1;
    if (ftruncate(fd, (off_t)bench_control_size(n_workers)) || pwrite(fd, &n_workers, sizeof n_workers, offsetof(bench_control, n_workers)) < 0) {
        close(fd);
        return -1;
    }
    return fd;
}

bench_control *bench_control_map(const char *path) {
    struct stat st;
    int fd = open(path, O_RDWR | O_CLOEXEC);
    if (fd < 0) return NULL;
    bench_control *c = fstat(fd, &st) ? MAP_FAILED : mmap(NULL, (size_t)st.st_size, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd);
    return c == MAP_FAILED ? NULL : c;
}

void bench_control_unmap(bench_control *c) { munmap(c, bench_control_size(c->n_workers)); }

static void wake_all(shmtf_word32 *word) { syscall(SYS_futex, word, FUTEX_WAKE, INT_MAX, NULL, NULL, 0); }

void bench_control_start(bench_control *c, const bench_phase *phase) {
    c->phase = *phase;
    increment32(&c->phase_number); /* release: the phase is described before it begins */
    wake_all(&c->phase_number);
}

void bench_control_stop(bench_control *c) {
    increment32(&c->stop);
    wake_all(&c->phase_number);
}

int64_t bench_control_next(bench_control *c, uint32_t last) {
    struct timespec slice = {0, SLICE_NS};
    if (load32_acquire(&c->phase_number) == last && !load32_acquire(&c->stop))
        syscall(SYS_futex, &c->phase_number, FUTEX_WAIT, last, &slice, NULL, 0);
    if (load32_acquire(&c->stop)) return -1;
    uint32_t now = load32_acquire(&c->phase_number);
    return now == last ? 0 : now;
}

void bench_worker_enter(bench_worker *w, bool ready) {
    fence_release(); /* `error` before `state` */
    store32_relaxed(&w->state, ready ? WORKER_READY : WORKER_FAILED);
}

void bench_worker_begin(bench_control *c, uint32_t index) {
    bench_worker *w = &c->worker[index];
    size_t counts = offsetof(bench_worker, reads);
    memset((char *)w + counts, 0, sizeof *w - counts);
}

void bench_worker_end(bench_control *c, uint32_t index, uint64_t read_retries, uint64_t write_retries, uint64_t cpu_ns) {
    bench_worker *w = &c->worker[index];
    w->read_retries = read_retries;
    w->write_retries = write_retries;
    w->cpu_ns = cpu_ns;
    fence_release(); /* pairs with the coordinator's acquire load of `done` */
    store32_relaxed(&w->done, load32_acquire(&c->phase_number));
}

void bench_worker_fail(bench_worker *w, const char *why) {
    w->failures++;
    if (!w->error[0]) snprintf(w->error, sizeof w->error, "%s", why);
}

static unsigned residue_bits(uint32_t write_len) {
    unsigned bits = 0;
    while (1u << bits < write_len) bits++;
    return bits;
}

int64_t bench_update_stamp(const bench_shape *shape, uint32_t first, int64_t now_ns) {
    unsigned bits = residue_bits(shape->write_len);
    return (now_ns >> bits << bits) | (first % shape->write_len);
}

/* Frame `child` carries `stamp`: after which frame did that update begin? */
static int64_t update_first(const bench_shape *shape, uint32_t child, int64_t stamp) {
    int64_t n = shape->write_len, residue = stamp & ((1ll << residue_bits(shape->write_len)) - 1), last = (int64_t)child - 1;
    return last - ((last - residue) % n + n) % n;
}

/* Two updates are mixed if one frame shows an update that another frame, which that update wrote too, does not have yet:
 * its stamp is older.  A newer one there is a later update. */
static bool is_mixed(const bench_shape *shape, uint32_t first, const int64_t *stamps, int64_t start_ns) {
    for (uint32_t k = 0; k < shape->read_len; k++) {
        if (stamps[k] <= start_ns || (k && stamps[k] == stamps[k - 1])) continue;
        int64_t from = update_first(shape, first + 1 + k, stamps[k]) - first, to = from + shape->write_len;
        for (int64_t i = from < 0 ? 0 : from; i < to && i < shape->read_len; i++)
            if (stamps[i] < stamps[k]) return true;
    }
    return false;
}

void bench_worker_check(bench_worker *w, const bench_shape *shape, uint32_t first, const int64_t *stamps, int64_t now_ns,
                        int64_t start_ns) {
    int64_t oldest = INT64_MAX, newest = INT64_MIN;
    double sum = 0, squares = 0; /* of stamps from the first one on: those are small numbers */
    for (uint32_t k = 0; k < shape->read_len; k++) {
        if (stamps[k] < oldest) oldest = stamps[k];
        if (stamps[k] > newest) newest = stamps[k];
        double d = (double)(stamps[k] - stamps[0]);
        sum += d;
        squares += d * d;
    }
    w->checked++;
    if (is_mixed(shape, first, stamps, start_ns)) w->mixed++;
    if (oldest <= start_ns) return;
    bench_histogram_record(&w->age_oldest_ns, now_ns - oldest);
    double mean = sum / shape->read_len, variance = squares / shape->read_len - mean * mean;
    bench_histogram_record(&w->age_mean_ns, now_ns - stamps[0] - (int64_t)mean);
    bench_histogram_record(&w->span_ns, newest - oldest);
    bench_histogram_record(&w->deviation_ns, variance > 0 ? (int64_t)sqrt(variance) : 0);
}
