/* SPDX-License-Identifier: Apache-2.0
 * Prints the compiler-filled field table, one field a line: record, field, offset, size, rule, split by tabs.
 * tools/check_layout.py compiles and runs it. */
#include "segment/layout.h"

#include <stdio.h>

int main(void) {
    size_t n = 0;
    const shmtf_field *fields = shmtf_layout_fields(&n);
    for (size_t i = 0; i < n; i++)
        printf("%s\t%s\t%u\t%u\t%s\n", fields[i].record, fields[i].field, (unsigned)fields[i].offset,
               (unsigned)fields[i].size, fields[i].rule ? fields[i].rule : "");
    return n == 0;
}
