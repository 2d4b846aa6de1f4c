/* Preloaded into a simulator build of ArduPilot that flies on its own physics: lets it run as many frames as the world orders.
 *
 * Once per frame, at its end and in the main thread, the simulator build asks by `kill(parent, 0)` whether its parent lives.
 * There it waits here: it says how many frames are over (uint32) to the UDP port in SAFLITE_GATE, and is told how many to run
 * (uint32). Its clock is that of its frames, so nothing else has to be owned.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <netinet/in.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

enum { LOST = 3 }; /* exit code */

static int channel = -1;
static uint32_t frames, left;

static void open_channel(void)
{
    const char *port = getenv("SAFLITE_GATE");
    struct sockaddr_in world = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    world.sin_port = htons((uint16_t)(port ? atoi(port) : 0));
    channel = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (channel < 0 || connect(channel, (struct sockaddr *)&world, sizeof world))
        _exit(LOST);
}

static void await_order(void)
{
    if (channel < 0)
        open_channel();
    if (send(channel, &frames, sizeof frames, 0) != (ssize_t)sizeof frames)
        _exit(LOST);
    for (;;) {
        const ssize_t got = recv(channel, &left, sizeof left, 0);
        if (got == (ssize_t)sizeof left && left > 0)
            return;
        if (got >= 0 || errno != EINTR)
            _exit(LOST);
    }
}

__attribute__((visibility("default"))) int kill(pid_t pid, int number)
{
    if (number == 0 && pid == getppid() && syscall(SYS_gettid) == getpid()) {
        frames++;
        if (left == 0 || --left == 0)
            await_order();
    }
    return (int)syscall(SYS_kill, pid, number);
}
