/* SPDX-License-Identifier: Apache-2.0
 *
 * Is what a protocol answers right?  A fast wrong answer must not reach a table.
 */
#ifndef SHMTF_BENCH_VERIFY_H
#define SHMTF_BENCH_VERIFY_H

#include "protocol.h"

/* Write every frame once and compare lookups with the product of what was written.  Before anybody else is about. */
bool bench_verify(const bench_protocol *p, const char *place, const bench_shape *shape, char error[BENCH_ERROR_SIZE]);

#endif
