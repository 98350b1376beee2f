/* SPDX-License-Identifier: Apache-2.0
 *
 * Named steps of the protocol, at which a test stops or kills a process.  In builds without SHMTF_STEPS, and so in
 * every build that is shipped, there is nothing here.
 */
#ifndef SHMTF_SEGMENT_FAILPOINT_H
#define SHMTF_SEGMENT_FAILPOINT_H

#ifdef SHMTF_STEPS
void shmtf_failpoint(const char *name);
#define SHMTF_FAILPOINT(name) shmtf_failpoint(name)
#else
#define SHMTF_FAILPOINT(name) ((void)0)
#endif

#endif
