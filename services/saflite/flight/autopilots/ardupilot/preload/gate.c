/* The gate: where the autopilot waits, takes orders and is forked. */
#define _GNU_SOURCE
#include "gate.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

static const uint32_t FORK = UINT32_MAX;

Gate gate = {.files = {-1, STDOUT_FILENO, -1, -1, -1}};
static uint32_t frames, left;
static int greeted;

__attribute__((constructor)) static void open_gate(void)
{
    const char *told = getenv("SAFLITE_GATE");
    gate.parent = getppid();
    if (told == NULL
        || sscanf(told, "%d:%d:%d:%d:%d", &gate.files[GATE_CHANNEL], &gate.own_physics, &gate.no_log, &gate.physics_port,
                  &gate.receiver_port) != 5)
        gate.files[GATE_CHANNEL] = -1;
}

static void say(uint32_t word)
{
    if (send(gate.files[GATE_CHANNEL], &word, sizeof word, MSG_NOSIGNAL) != (ssize_t)sizeof word)
        _exit(LOST);
}

/* Whether it holds what a raw fork would not copy, or would share: further threads, pipes. */
static int unforkable(void)
{
    int threads = 0, pipes = 0;
    char path[300], target[64];
    DIR *tasks = opendir("/proc/self/task"), *files = opendir("/proc/self/fd");
    for (struct dirent *one; tasks && (one = readdir(tasks));)
        threads += one->d_name[0] != '.';
    for (struct dirent *one; files && (one = readdir(files));) {
        snprintf(path, sizeof path, "/proc/self/fd/%s", one->d_name);
        const ssize_t size = readlink(path, target, sizeof target);
        pipes += atoi(one->d_name) > STDERR_FILENO && size > 5 && memcmp(target, "pipe:", 5) == 0;
    }
    if (tasks)
        closedir(tasks);
    if (files)
        closedir(files);
    return threads != 1 + __atomic_load_n(&gate.parked, __ATOMIC_ACQUIRE) || pipes != 0;
}

/* In the fork: put what was given in the places of what was inherited, as it was: waiting or not. */
static void go_on_with(const int *given, int count)
{
    for (int i = 0; i < count; i++) {
        const int flags = fcntl(gate.files[i], F_GETFL);
        dup3(given[i], gate.files[i], i == GATE_CONSOLE ? 0 : O_CLOEXEC);
        fcntl(gate.files[i], F_SETFL, flags & O_NONBLOCK);
        close(given[i]);
    }
    dup2(STDOUT_FILENO, STDERR_FILENO);
    gate.forked = 1, gate.parked = 0;
}

static void fork_with(struct msghdr *message)
{
    const int wanted = gate.own_physics ? GATE_PHYSICS : GATE_FILES;
    const struct cmsghdr *control = CMSG_FIRSTHDR(message);
    int given[GATE_FILES], known = 1;
    if (control == NULL || control->cmsg_type != SCM_RIGHTS || control->cmsg_len != CMSG_LEN(wanted * sizeof *given))
        _exit(LOST);
    memcpy(given, CMSG_DATA(control), wanted * sizeof *given);
    for (int i = 0; i < wanted; i++)
        known &= gate.files[i] >= 0;
    while (waitpid(-1, NULL, WNOHANG) > 0) /* take leave of forks that have ended */
        continue;
    fflush(NULL);
    /* raw: with the C library's own the main thread gets another number, and mutexes that it holds are nobody's then */
    const long pid = known && !unforkable() ? syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0) : -1;
    if (pid == 0) {
        go_on_with(given, wanted);
        return;
    }
    for (int i = 0; i < wanted; i++)
        close(given[i]);
    say(pid > 0 ? (uint32_t)pid : 0);
}

/* Take an order; returns how many frames it lets run, 0 where it was another one. Ends with the world. */
static uint32_t take_order(void)
{
    char room[CMSG_SPACE(GATE_FILES * sizeof(int))];
    uint32_t order;
    struct iovec part = {&order, sizeof order};
    struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = room, .msg_controllen = sizeof room};
    ssize_t got;
    do
        got = recvmsg(gate.files[GATE_CHANNEL], &message, MSG_CMSG_CLOEXEC);
    while (got < 0 && errno == EINTR);
    if (got != (ssize_t)sizeof order || order == 0)
        _exit(LOST);
    if (order != FORK)
        return order;
    fork_with(&message);
    return 0;
}

/* On its own physics, at the end of a frame: say how many are over once those ordered are, and wait for the next order. */
void gate_frame_over(void)
{
    frames++;
    if (left > 1) {
        left--;
        return;
    }
    say(frames);
    do
        left = take_order();
    while (left == 0);
}

/* In our world: wait until its state is here. */
void gate_await_world(void)
{
    if (!greeted) {
        greeted = 1;
        say(0);
    }
    for (;;) {
        struct pollfd both[2] = {{gate.files[GATE_PHYSICS], POLLIN, 0}, {gate.files[GATE_CHANNEL], POLLIN, 0}};
        if (poll(both, 2, -1) < 0)
            continue;
        if (both[0].revents)
            return;
        if (both[1].revents)
            take_order();
    }
}
