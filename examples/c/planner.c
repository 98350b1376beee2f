/* SPDX-License-Identifier: Apache-2.0
 *
 * Where is SOURCE, seen from TARGET?  Attaches to a store read-only and prints the newest transform between two
 * frames.  With a fourth argument it goes on and prints again after each commit that touches either frame.
 *
 *   planner STORE TARGET SOURCE [follow]
 */
#include <shmtf.h>

#include <inttypes.h>
#include <stdio.h>

#define SECOND_NS 1000000000ll

static int fail(const shmtf_error *error) {
    char message[512];
    fprintf(stderr, "planner: %s\n", shmtf_error_message(error, message, sizeof message));
    return 1;
}

static void print_result(const shmtf_result *result) {
    const shmtf_pose *p = &result->pose;
    printf("translation %.6f %.6f %.6f  rotation %.6f %.6f %.6f %.6f  ", p->x, p->y, p->z, p->qx, p->qy, p->qz, p->qw);
    if (result->all_static)
        printf("static\n");
    else
        printf("stamp %" PRId64 "\n", result->stamp_ns);
}

static int follow(shmtf_store *store, shmtf_ref target, shmtf_ref source, int for_ever, shmtf_error *error) {
    const shmtf_ref frames[2] = {target, source};
    uint64_t version = shmtf_commit_version(store);
    for (;;) {
        shmtf_result result = {0};
        if (shmtf_lookup_latest_transform(store, NULL, target, source, SECOND_NS, &result, error)) return fail(error);
        print_result(&result);
        if (!for_ever) return 0;
        fflush(stdout);
        shmtf_status status = shmtf_wait_for_change(store, frames, 2, version, -1, &version, error);
        if (status == SHMTF_INTERRUPTED) return 0;
        if (status) return fail(error);
    }
}

int main(int argc, char **argv) {
    if (argc != 4 && argc != 5) {
        fprintf(stderr, "usage: %s STORE TARGET SOURCE [follow]\n", argv[0]);
        return 2;
    }
    shmtf_store *store = NULL;
    shmtf_error error = {0};
    if (shmtf_attach(argv[1], SHMTF_READONLY, "planner", SECOND_NS, &store, &error)) return fail(&error);
    int result = follow(store, shmtf_by_name(argv[2]), shmtf_by_name(argv[3]), argc == 5, &error);
    shmtf_close(store);
    return result;
}
