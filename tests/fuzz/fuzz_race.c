/* SPDX-License-Identifier: Apache-2.0
 *
 * Corruption goes on while a store is read or written: before about every k-th access a word changes, and half of the
 * time it is the very word that the call is looking at, so that whatever it loads twice differs.  In one thread, hence
 * the same at each repetition.
 */
#include "fuzz.h"

const char *const fuzz_target = "fuzz_race";

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const uint32_t periods[] = {2, 8, 30, 200, 1000};
    const image *i = images_begin(data, size);
    shmtf_geometry geo;
    bench *b = bench_load(i, one_in(4));
    image_geometry(i->world, &geo);
    if (take(2)) mutate_some(b->base + 0, &geo);
    bool writes = one_in(3);
    uint32_t calls = 1 + take(10);
    shmtf_store *h = bench_attach(b->fd, writes ? 0 : take(2) ? SHMTF_READONLY : 0);
    if (!h) return 0;
    watch_disturb(b->base, &geo, periods[take(5)]);
    for (uint32_t k = 0; k < calls; k++) {
        if (writes && take(2)) call_write(h);
        else call_read(h, take(14));
    }
    watch_disturb(NULL, &geo, 0);
    watch_nothing();
    shmtf_close(h);
    return 0;
}
