/* SPDX-License-Identifier: Apache-2.0
 * A writer slot is held for exactly as long as its owner's memory is there: not by its descriptors, not by its forked
 * children, not over exec; and a death frees it.  A file gets its name whole, once.  Tier: test. */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include "segment/peer.h"
#include "shmtf.h"
#include "support/check.h"

static char path[96];
static int query;
static map_file file;

static bool held(unsigned slot) { return peer_alive(query, &file, slot); }
static void *claim(unsigned slot) {
    unsigned got;
    void *anchor;
    int fd = open(path, O_RDWR | O_CLOEXEC);
    NEED(fd >= 0 && peer_claim(fd, 64, slot, &got, &anchor) == 0 && got == slot);
    close(fd);
    return anchor;
}

/* A child that runs `body` with one end of a pipe, then waits to be killed; returns when it has said a byte. */
static pid_t child(void (*body)(int pipe_end), int *from) {
    int ends[2];
    char c;
    NEED(pipe(ends) == 0);
    pid_t pid = fork();
    if (!pid) {
        alarm(60);
        close(ends[0]);
        body(ends[1]);
        _exit(0);
    }
    close(ends[1]);
    NEED(read(ends[0], &c, 1) == 1);
    if (from) *from = ends[0];
    else close(ends[0]);
    return pid;
}
static void say(int fd) { NEED(write(fd, "x", 1) == 1); }
static void bury(pid_t pid) {
    kill(pid, SIGKILL);
    NEED(waitpid(pid, NULL, 0) == pid);
}

static void case_mapping_alone(void) {
    void *anchor = claim(1);
    CHECK(held(1));
    peer_release(anchor);
    CHECK(!held(1));
}

/* The forked child lives on, its parent is killed: the slot is free. */
static void claim_and_fork(int fd) {
    claim(2);
    pid_t heir = fork();
    if (!heir)
        for (;;) pause();
    NEED(write(fd, "x", 1) == 1 && write(fd, &heir, sizeof heir) == sizeof heir);
    pause();
}
static void case_forked_child_inherits_nothing(void) {
    int from;
    pid_t heir, owner = child(claim_and_fork, &from);
    NEED(read(from, &heir, sizeof heir) == sizeof heir);
    close(from);
    CHECK(held(2));
    bury(owner);
    CHECK(!held(2));
    CHECK(kill(heir, 0) == 0);
    kill(heir, SIGKILL);
}

/* In the child the mapping is not there: a stray access is its own fault, not a foreign claim. */
static void case_child_has_no_mapping(void) {
    volatile char *anchor = claim(3);
    pid_t heir = fork();
    if (!heir) {
        signal(SIGSEGV, SIG_DFL);
        _exit(*anchor);
    }
    int status;
    NEED(waitpid(heir, &status, 0) == heir);
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
    CHECK(WIFSIGNALED(status) && WTERMSIG(status) == SIGSEGV);
#endif
    CHECK(held(3));
    peer_release((void *)(uintptr_t)anchor);
}

static void claim_and_close_all(int fd) {
    claim(4);
    for (int i = 3; i < 1024; i++)
        if (i != fd) close(i);
    int null = open("/dev/null", O_RDWR);
    for (int i = 0; i < 20; i++)
        if (i != fd) dup2(null, i); /* as daemons do */
    say(fd);
    pause();
}
static void case_closing_every_descriptor(void) {
    pid_t owner = child(claim_and_close_all, NULL);
    CHECK(held(4));
    bury(owner);
    CHECK(!held(4));
}

static void claim_and_exec(int fd) {
    claim(5);
    char command[64];
    snprintf(command, sizeof command, "echo >&%d; read none", fd);
    execl("/bin/sh", "sh", "-c", command, (char *)NULL);
}
static void case_exec(void) {
    pid_t owner = child(claim_and_exec, NULL); /* speaks after the exec */
    CHECK(kill(owner, 0) == 0);
    CHECK(!held(5));
    bury(owner);
}

static void claim_and_pause(int fd) {
    claim(6);
    say(fd);
    pause();
}
static void case_kill(void) {
    for (int i = 0; i < 200; i++) {
        pid_t owner = child(claim_and_pause, NULL);
        CHECK(held(6));
        kill(owner, SIGSTOP);
        CHECK(held(6));
        bury(owner);
        CHECK(!held(6)); /* once it can be waited for, it holds nothing */
    }
}

static void case_name_once(void) {
    char name[96];
    shmtf_error e;
    const shmtf_config c = {.max_frames = 4, .history = 2, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 2};
    snprintf(name, sizeof name, "%s-once", path + strlen("/dev/shm/"));
    pid_t pid[8];
    int made = 0;
    for (int i = 0; i < 8; i++)
        if (!(pid[i] = fork())) _exit((int)shmtf_create(name, &c, 0600, &e));
    for (int i = 0; i < 8; i++) {
        int status;
        NEED(waitpid(pid[i], &status, 0) == pid[i] && WIFEXITED(status));
        made += WEXITSTATUS(status) == SHMTF_OK;
        CHECK(WEXITSTATUS(status) == SHMTF_OK || WEXITSTATUS(status) == SHMTF_EXISTS);
    }
    EQUAL(made, 1);
    EQUAL(shmtf_unlink(name, &e), SHMTF_OK);
}

/* Beyond the largest file that the process may make: an error, not a signal. */
static void case_file_size_limit(void) {
    pid_t pid = fork();
    if (!pid) {
        shmtf_config c;
        shmtf_error e;
        char name[96];
        const struct rlimit limit = {1 << 20, 1 << 20};
        shmtf_config_default(&c);
        snprintf(name, sizeof name, "%s-large", path + strlen("/dev/shm/"));
        signal(SIGXFSZ, SIG_DFL);
        NEED(setrlimit(RLIMIT_FSIZE, &limit) == 0);
        EQUAL(shmtf_create(name, &c, 0600, &e), SHMTF_FULL);
        EQUAL(e.sys_errno, EFBIG);
        EQUAL(shmtf_unlink(name, &e), SHMTF_NOT_FOUND);
        _exit(check_failures != 0);
    }
    int status;
    NEED(waitpid(pid, &status, 0) == pid);
    EQUAL(status, 0);
}

int main(void) {
    shmtf_error e;
    const shmtf_config c = {.max_frames = 4, .history = 2, .cache_time_ns = -1, .stream_bytes = 0, .max_writers = 64};
    alarm(200);
    snprintf(path, sizeof path, "/dev/shm/shmtf-test-ofd-%d", (int)getpid());
    NEED(shmtf_create(path + strlen("/dev/shm/"), &c, 0600, &e) == SHMTF_OK);
    query = open(path, O_RDONLY | O_CLOEXEC);
    NEED(query >= 0 && map_stat(query, &file) == 0);
    peer_fork_guard();
    case_mapping_alone();
    case_forked_child_inherits_nothing();
    case_child_has_no_mapping();
    case_closing_every_descriptor();
    case_exec();
    case_kill();
    case_name_once();
    case_file_size_limit();
    close(query);
    shmtf_unlink(path + strlen("/dev/shm/"), NULL);
    return check_result("ofd");
}
