/* The firmware's clock: it moves with what the firmware does, so that the same steps always take the same time.
 *
 * A reading costs READ_NS; a loop that reads without ever sleeping gets POLL_NS more for each reading after POLLS, or a
 * wait for a moment would never end. A sleep takes as long as asked and SLACK_NS longer: Linux's timer slack of
 * 50 us and a wake-up.
 */
#define _GNU_SOURCE
#include <sys/time.h>
#include <time.h>

#include "preload.h"

enum { READ_NS = 1000, POLL_NS = 4000, POLLS = 12, SLACK_NS = 60000 };

static const uint64_t SECOND_NS = 1000000000u;
static uint64_t now_ns, gate_ns;
static int readings;

uint64_t clock_now_ns(void) { return now_ns; }

static void sleep_for(uint64_t duration_ns)
{
    now_ns += duration_ns + SLACK_NS, readings = 0;
    if (current_thread() != MAIN_THREAD)
        return;
    while (now_ns >= gate_ns)
        gate_step(&gate_ns);
}

EXPORT int clock_gettime(clockid_t clock, struct timespec *into)
{
    (void)clock;
    now_ns += READ_NS + (++readings > POLLS ? POLL_NS : 0);
    into->tv_sec = (time_t)(now_ns / SECOND_NS), into->tv_nsec = (long)(now_ns % SECOND_NS);
    return 0;
}

EXPORT int gettimeofday(struct timeval *restrict into, void *restrict zone)
{
    (void)zone;
    into->tv_sec = (time_t)(now_ns / SECOND_NS), into->tv_usec = (suseconds_t)(now_ns % SECOND_NS / 1000);
    return 0;
}

EXPORT time_t time(time_t *into)
{
    const time_t now = (time_t)(now_ns / SECOND_NS);
    if (into != NULL)
        *into = now;
    return now;
}

EXPORT int nanosleep(const struct timespec *request, struct timespec *left)
{
    if (left != NULL)
        left->tv_sec = 0, left->tv_nsec = 0;
    sleep_for((uint64_t)request->tv_sec * SECOND_NS + (uint64_t)request->tv_nsec);
    return 0;
}
