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
enum { PIPES = 16, WAITING_MAX = 1 << 20 };

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

/* A pipe that leads from the autopilot to itself: the simulated GPS of older builds. A fork would share it. */
typedef struct {
    char name[32];
    int ends[2]; /* to read from, to write to; -1 while not found */
} Pipe;

static int threads(void)
{
    int count = 0;
    DIR *tasks = opendir("/proc/self/task");
    for (struct dirent *one; tasks && (one = readdir(tasks));)
        count += one->d_name[0] != '.';
    if (tasks)
        closedir(tasks);
    return count;
}

static void note_end(Pipe *pipes, int *count, const char *name, int file)
{
    int i = 0;
    while (i < *count && strcmp(pipes[i].name, name) != 0)
        i++;
    if (i == PIPES)
        return;
    if (i == *count) {
        strcpy(pipes[i].name, name);
        pipes[i].ends[0] = pipes[i].ends[1] = -1;
        ++*count;
    }
    pipes[i].ends[(fcntl(file, F_GETFL) & O_ACCMODE) == O_WRONLY] = file;
}

/* Returns how many pipes there are; -1 where one leads elsewhere, or there are too many. */
static int own_pipes(Pipe pipes[PIPES])
{
    int count = 0;
    char path[300], name[32];
    DIR *files = opendir("/proc/self/fd");
    for (struct dirent *one; files && (one = readdir(files));) {
        snprintf(path, sizeof path, "/proc/self/fd/%s", one->d_name);
        const ssize_t size = readlink(path, name, sizeof name - 1);
        name[size > 0 ? size : 0] = 0;
        if (atoi(one->d_name) > STDERR_FILENO && strncmp(name, "pipe:", 5) == 0)
            note_end(pipes, &count, name, atoi(one->d_name));
    }
    if (files)
        closedir(files);
    for (int i = 0; i < count; i++)
        if (pipes[i].ends[0] < 0 || pipes[i].ends[1] < 0)
            return -1;
    return count < PIPES ? count : -1;
}

/* In the fork: in place of a pipe that it shares, one of its own that holds the same unread bytes. */
static void own(const Pipe *shared)
{
    int made[2];
    if (pipe2(made, O_CLOEXEC) != 0)
        _exit(LOST);
    while (tee(shared->ends[0], made[1], WAITING_MAX, SPLICE_F_NONBLOCK) < 0 && errno == EINTR)
        continue;
    for (int i = 0; i < 2; i++) {
        const int flags = fcntl(shared->ends[i], F_GETFL);
        dup3(made[i], shared->ends[i], O_CLOEXEC);
        fcntl(shared->ends[i], F_SETFL, flags & O_NONBLOCK);
        close(made[i]);
    }
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
    Pipe pipes[PIPES];
    const int shared = own_pipes(pipes);
    int given[GATE_FILES], known = shared >= 0 && threads() == 1 + __atomic_load_n(&gate.parked, __ATOMIC_ACQUIRE);
    if (control == NULL || control->cmsg_type != SCM_RIGHTS || control->cmsg_len != CMSG_LEN(wanted * sizeof *given))
        _exit(LOST);
    memcpy(given, CMSG_DATA(control), wanted * sizeof *given);
    for (int i = 0; i < wanted; i++)
        known &= gate.files[i] >= 0;
    while (waitpid(-1, NULL, WNOHANG) > 0) /* take leave of forks that have ended */
        continue;
    fflush(NULL);
    /* raw: with the C library's own the main thread gets another number, and mutexes that it holds are nobody's then */
    const long pid = known ? syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0) : -1;
    if (pid == 0) {
        go_on_with(given, wanted);
        for (int i = 0; i < shared; i++)
            own(&pipes[i]);
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
