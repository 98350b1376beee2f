/* SPDX-License-Identifier: Apache-2.0
 *
 * Attach to a corrupted store and read everything, writable or read-only; some files have a size that does not fit.
 */
#include "fuzz.h"

#include <unistd.h>

const char *const fuzz_target = "fuzz_read";

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const image *i = images_begin(data, size);
    shmtf_geometry geo;
    unsigned flags = take(2) ? SHMTF_READONLY : 0;
    bool odd = one_in(32);
    int fd;
    if (odd) {
        fd = bench_odd_size(i);
    } else {
        bench *b = bench_load(i, one_in(2));
        image_geometry(i->world, &geo);
        mutate_some(b->base, &geo);
        fd = b->fd;
    }
    shmtf_store *h = bench_attach(fd, flags);
    if (h) call_reads(h);
    watch_nothing();
    shmtf_close(h);
    if (odd) close(fd);
    return 0;
}
