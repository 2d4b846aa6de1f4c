/* The few calls of the autopilot that are looked at on their way: which sockets are which, and where it waits for the world. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <netinet/in.h>
#include <pthread.h>
#include <semaphore.h>
#include <signal.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "gate.h"

#define HOOK __attribute__((visibility("default")))
enum { RESTS_WITHIN_S = 2 };

static int port_of(const struct sockaddr *address)
{
    struct sockaddr_in known;
    if (address == NULL || address->sa_family != AF_INET)
        return -1;
    memcpy(&known, address, sizeof known);
    return ntohs(known.sin_port);
}

static int gated(void) { return gate.files[GATE_CHANNEL] >= 0; }
static int in_main_thread(void) { return syscall(SYS_gettid) == getpid(); }

/* Once per frame, at its end and in the main thread, the simulator build asks whether its parent lives. */
HOOK int kill(pid_t pid, int number)
{
    if (gated() && gate.own_physics && number == 0 && pid == gate.parent && in_main_thread())
        gate_frame_over();
    return (int)syscall(SYS_kill, pid, number);
}

/* The first that calls is the world, over MAVLink. */
HOOK int accept4(int file, struct sockaddr *address, socklen_t *size, int flags)
{
    const int found = (int)syscall(SYS_accept4, file, address, size, flags);
    if (found >= 0 && gate.files[GATE_LINK] < 0)
        gate.files[GATE_LINK] = found;
    return found;
}

HOOK int accept(int file, struct sockaddr *address, socklen_t *size) { return accept4(file, address, size, 0); }

HOOK int bind(int file, const struct sockaddr *address, socklen_t size)
{
    if (gated() && port_of(address) == gate.receiver_port)
        gate.files[GATE_RECEIVER] = file;
    return (int)syscall(SYS_bind, file, address, size);
}

HOOK ssize_t sendto(int file, const void *data, size_t bytes, int flags, const struct sockaddr *address, socklen_t size)
{
    const int to_world = gated() && port_of(address) == gate.physics_port;
    if (to_world && gate.files[GATE_PHYSICS] < 0)
        gate.files[GATE_PHYSICS] = file;
    if (to_world && gate.forked && file == gate.files[GATE_PHYSICS])
        address = NULL, size = 0; /* a fork has a socket pair there */
    return (ssize_t)syscall(SYS_sendto, file, data, bytes, flags, address, size);
}

/* The thread that would write the log runs even where none is kept. It stands where it first sleeps, holding no lock.
 * The thread that plans ways round obstacles sleeps by wall time while it waits for the clock: it gets a turn a frame instead.
 */
static pthread_t logger, planner;
static int logger_known, planner_known;
static sem_t planner_turn, planner_rests;

/* Wait until the planner sleeps; whether it does. It might need a lock that the main thread holds: not for ever. */
static int rested(void)
{
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec += RESTS_WITHIN_S;
    while (sem_timedwait(&planner_rests, &until) != 0)
        if (errno != EINTR)
            return 0;
    return 1;
}

/* Once per frame, in the main thread: let the planner run until it sleeps again. */
static void give_planner_its_turn(void)
{
    static int runs_on;
    if (!__atomic_load_n(&planner_known, __ATOMIC_ACQUIRE) || (runs_on && sem_trywait(&planner_rests) != 0))
        return;
    sem_post(&planner_turn);
    runs_on = !rested();
}

HOOK int pthread_setname_np(pthread_t thread, const char *name)
{
    static int (*next)(pthread_t, const char *);
    if (next == NULL)
        *(void **)&next = dlsym(RTLD_NEXT, "pthread_setname_np");
    if (gated() && gate.no_log && strcmp(name, "log_io") == 0) {
        logger = thread;
        __atomic_store_n(&logger_known, 1, __ATOMIC_RELEASE);
    }
    if (gated() && !gate.own_physics && strcmp(name, "avoidance") == 0 && !planner_known) {
        sem_init(&planner_turn, 0, 0), sem_init(&planner_rests, 0, 0);
        planner = thread;
        __atomic_store_n(&planner_known, 1, __ATOMIC_RELEASE);
        rested();
    }
    return next(thread, name);
}

HOOK int usleep(useconds_t time_us)
{
    const struct timespec time = {time_us / 1000000, time_us % 1000000 * 1000L};
    if (__atomic_load_n(&logger_known, __ATOMIC_ACQUIRE) && pthread_equal(pthread_self(), logger)) {
        __atomic_store_n(&gate.parked, 1, __ATOMIC_RELEASE);
        for (;;)
            pause();
    }
    if (__atomic_load_n(&planner_known, __ATOMIC_ACQUIRE) && pthread_equal(pthread_self(), planner)) {
        sem_post(&planner_rests);
        while (sem_wait(&planner_turn) != 0)
            continue;
        return 0;
    }
    return (int)syscall(SYS_clock_nanosleep, CLOCK_REALTIME, 0, &time, NULL);
}

HOOK int select(int count, fd_set *in, fd_set *out, fd_set *odd, struct timeval *limit)
{
    const int world = gate.files[GATE_PHYSICS];
    if (gated() && world >= 0 && count == world + 1 && in && FD_ISSET(world, in) && in_main_thread()) {
        give_planner_its_turn();
        gate_await_world();
        return 1;
    }
    struct timespec left = {limit ? limit->tv_sec : 0, limit ? limit->tv_usec * 1000L : 0};
    return (int)syscall(SYS_pselect6, count, in, out, odd, limit ? &left : NULL, NULL);
}
