/* The gate: where the firmware tells what it did and waits for the world's next step, is forked, and ends. */
#define _GNU_SOURCE
#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/personality.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "preload.h"

enum { CPU_LIMIT_S = 120, SIGNALS = 6 };

static int link_fd = -1;
static LinkUp up;
static LinkDown down;

/* The world's socket is a true one, so it is used past those of sockets.c. */
static ssize_t receive(struct msghdr *message)
{
    ssize_t got;
    do
        got = syscall(SYS_recvmsg, link_fd, message, MSG_CMSG_CLOEXEC);
    while (got < 0 && errno == EINTR);
    return got;
}

static size_t up_bytes(void)
{
    size_t bytes = offsetof(LinkUp, serial);
    for (int i = 0; i < LINK_PORTS; i++)
        bytes += up.serial_bytes[i];
    return bytes;
}

static void tell(void)
{
    up.pid = (int32_t)syscall(SYS_getpid);
    if (syscall(SYS_sendto, link_fd, &up, up_bytes(), MSG_NOSIGNAL, NULL, 0) < 0)
        _exit(0);
}

static void watch(void) /* a process that hangs or outlives the world's must not stay */
{
    const struct rlimit cpu = {CPU_LIMIT_S, CPU_LIMIT_S}, core = {0, 0};
    setrlimit(RLIMIT_CPU, &cpu);
    setrlimit(RLIMIT_CORE, &core);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
}

static void go_on_as_fork(int socket, int console)
{
    syscall(SYS_dup3, console, 1, 0), syscall(SYS_dup3, console, 2, 0);
    syscall(SYS_close, console), syscall(SYS_close, link_fd);
    link_fd = socket;
    watch();
}

/* Fork; returns 1 in the fork. */
static int fork_with(struct msghdr *message)
{
    int given[2] = {-1, -1};
    const struct cmsghdr *control = CMSG_FIRSTHDR(message);
    if (control == NULL || control->cmsg_type != SCM_RIGHTS || control->cmsg_len != CMSG_LEN(sizeof given))
        return 0;
    memcpy(given, CMSG_DATA(control), sizeof given);
    fflush(NULL);
    while (waitpid(-1, NULL, WNOHANG) > 0) /* take leave of forks that have ended; their core time is added to ours */
        continue;
    const pid_t pid = fork();
    if (pid == 0) {
        go_on_as_fork(given[0], given[1]);
        return 1;
    }
    syscall(SYS_close, given[0]), syscall(SYS_close, given[1]);
    return 0;
}

static void wait_for_step(void)
{
    for (;;) {
        char control[CMSG_SPACE(2 * sizeof(int))];
        struct iovec part = {&down, sizeof down};
        struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = control,
                                 .msg_controllen = sizeof control};
        const ssize_t got = receive(&message);
        if (got < (ssize_t)offsetof(LinkDown, serial))
            _exit(0); /* the world is gone */
        if (down.kind == LINK_STEP)
            return;
        if (fork_with(&message))
            tell();
    }
}

void gate_step(uint64_t *deadline_ns)
{
    sockets_collect(&up);
    up.kind = LINK_STEPPED, up.code = 0, up.time_ns = clock_now_ns();
    tell();
    wait_for_step();
    *deadline_ns += down.step_ns;
    sockets_deliver(&down);
    resume_helpers();
}

_Noreturn void gate_exit(int code)
{
    fflush(NULL);
    memset(up.serial_bytes, 0, sizeof up.serial_bytes);
    sockets_collect(&up);
    up.kind = LINK_EXIT, up.code = (uint32_t)code, up.time_ns = clock_now_ns();
    tell();
    _exit(code);
}

EXPORT _Noreturn void exit(int code) { gate_exit(code); }

static void die(int number)
{
    char text[] = "firmware: signal 00\n";
    text[17] = (char)('0' + number / 10), text[18] = (char)('0' + number % 10);
    if (write(2, text, sizeof text - 1) < 0)
        _exit(1);
    signal(number, SIG_DFL);
    raise(number);
}

/* Load the program anew without random addresses, so that what reads or writes past its memory does so the same each
 * time; where the kernel forbids it, it goes on as it is. */
static void same_addresses(char **arguments)
{
    const int now = personality(0xffffffff);
    if (now < 0 || now & ADDR_NO_RANDOMIZE || personality((unsigned long)now | ADDR_NO_RANDOMIZE) < 0)
        return;
    if (personality(0xffffffff) & ADDR_NO_RANDOMIZE)
        execv("/proc/self/exe", arguments);
}

__attribute__((constructor)) static void start(int count, char **arguments)
{
    (void)count;
    static const int fatal[SIGNALS] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGXCPU};
    const char *fd = getenv("SAFLITE_LINK"), *sanitized = getenv("ASAN_OPTIONS");
    if (fd == NULL)
        return;
    same_addresses(arguments);
    link_fd = atoi(fd);
    for (int i = 0; i < SIGNALS && sanitized == NULL; i++)
        signal(fatal[i], die);
    watch();
}
