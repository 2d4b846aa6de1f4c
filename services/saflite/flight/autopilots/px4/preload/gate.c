/* Preloaded into a simulator build of PX4 that flies on its own physics (SIH): makes it wait for the world after each
 * of its steps, and run as many as the world orders.
 *
 * SAFLITE_GATE holds the descriptor of a socket pair's end (SOCK_SEQPACKET); both ways 4 bytes: how many steps are over,
 * how many to run. Its loop looks at the wall clock and then sleeps; nothing else of PX4 asks `gettimeofday`. Its clock is
 * that of its steps, so nothing else has to be owned.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define HOOK __attribute__((visibility("default")))

enum { LOST = 3 }; /* exit code */

static int channel = -1;
static uint32_t over, left; /* of the one thread that is held */
static _Thread_local int looked;

__attribute__((constructor)) static void open_gate(void)
{
    const char *told = getenv("SAFLITE_GATE");
    if (told != NULL)
        channel = atoi(told);
}

static void say(uint32_t word)
{
    if (send(channel, &word, sizeof word, MSG_NOSIGNAL) != (ssize_t)sizeof word)
        _exit(LOST);
}

/* Ends with the world. */
static uint32_t take_order(void)
{
    uint32_t order;
    ssize_t got;
    do
        got = recv(channel, &order, sizeof order, 0);
    while (got < 0 && errno == EINTR);
    if (got != (ssize_t)sizeof order || order == 0)
        _exit(LOST);
    return order;
}

static void step_over(void)
{
    over++;
    if (left > 1) {
        left--;
        return;
    }
    say(over);
    left = take_order();
}

HOOK int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    looked = 1;
    return (int)syscall(SYS_gettimeofday, now, zone);
}

HOOK int usleep(useconds_t time_us)
{
    if (channel >= 0 && looked) {
        looked = 0;
        step_over();
        return 0;
    }
    struct timespec rest = {time_us / 1000000, time_us % 1000000 * 1000L};
    if (syscall(SYS_nanosleep, &rest, NULL) == 0)
        return 0;
    return -1; /* the system call sets errno */
}
