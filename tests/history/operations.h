/* SPDX-License-Identifier: Apache-2.0
 *
 * The operations of a recorded process, each chosen at random, done, and logged.
 */
#ifndef SHMTF_TESTS_OPERATIONS_H
#define SHMTF_TESTS_OPERATIONS_H

#include <stdbool.h>

#include "history.h"
#include "shmtf.h"

typedef struct {
    shmtf_store *h;
    history_control *all;
    char *buffer; /* this process's part of the log */
    unsigned n;   /* which */
    uint32_t process;
    uint64_t random, next_value;
    char names[N_NAMES][8];
    shmtf_frame bank[BANK], handle[N_NAMES]; /* as they were last known */
} member;

enum { TICK = 1000 }; /* from one stamp to the next */

uint64_t member_random(member *m);
uint64_t member_below(member *m, uint64_t n);
/* Is there room in the log for another operation? */
bool member_has_room(const member *m);

void write_group(member *m);
void write_bank(member *m);
void write_something(member *m);
void read_something(member *m);
/* Everything, once: what the end of a history is compared with. */
void read_all(member *m);

/* An entry at the end of the log; the moment before; it counts from now on; the moment after, and the outcome. */
history_entry *log_open(member *m, history_kind kind);
void log_begin(member *m, history_entry *e);
void log_publish(member *m, const history_entry *e);
void log_end(member *m, history_entry *e, shmtf_status st);

#endif
