/* SPDX-License-Identifier: Apache-2.0
 * The step hooks of programs that have none of their own. */
#include "segment/atomic.h"
#include "segment/failpoint.h"

__attribute__((weak)) void shmtf_step(int kind, const void *word) { (void)kind, (void)word; }
__attribute__((weak)) void shmtf_failpoint(const char *name) { (void)name; }
