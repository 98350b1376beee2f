/* SPDX-License-Identifier: Apache-2.0
 *
 * Every write on a corrupted store: locks of the dead and of the living, adoption of slots full of garbage, repair.  In
 * half of the files another handle holds a writer slot, and sometimes it is the one that writes: then the store under a
 * running writer changes.
 */
#include "fuzz.h"

const char *const fuzz_target = "fuzz_write";

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const image *i = images_begin(data, size);
    shmtf_geometry geo;
    bench *b = bench_load(i, one_in(2));
    image_geometry(i->world, &geo);
    mutate_some(b->base, &geo);
    bool by_peer = b->peer && one_in(4);
    uint32_t calls = 1 + take(6);
    shmtf_store *h = bench_attach(b->fd, one_in(32) ? SHMTF_READONLY : 0);
    if (!h) return 0;
    for (uint32_t k = 0; k < calls; k++) {
        if (one_in(12)) call_check(h, 1);
        else call_write(h);
    }
    if (by_peer) {
        watch_store(b->peer);
        call_write(b->peer);
        watch_store(h);
    }
    for (uint32_t k = 0; k < 3; k++) call_read(h, take(14));
    watch_nothing();
    shmtf_close(h);
    return 0;
}
