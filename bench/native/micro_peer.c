/* SPDX-License-Identifier: Apache-2.0 */
#define _GNU_SOURCE
#include "micro_peer.h"

#include <dlfcn.h>

const micro_peer *micro_peer_load(const char *path, char error[MICRO_ERROR_SIZE]) {
    const micro_peer *(*get)(void) = NULL;
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (library) *(void **)&get = dlsym(library, MICRO_PEER_SYMBOL); /* POSIX: a function's address fits */
    if (get) return get();
    snprintf(error, MICRO_ERROR_SIZE, "%s", dlerror());
    return NULL;
}
