/* Sockets that lead nowhere but to the world: UDP for state, RC and motors, TCP listeners for the serial ports. */
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <stdarg.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <unistd.h>

#include "preload.h"

enum { FIRST = 900, COUNT = 100 }; /* descriptors of ours; select() knows those below 1024 */
enum { PORT_MOTORS = 9002, PORT_STATE = 9003, PORT_RC = 9004, PORT_SERIAL = 5760 };
enum { FREE, DATAGRAM, LISTENER, CONNECTION };

typedef struct { int kind, port; } Socket;
typedef struct { uint8_t bytes[LINK_DOWN_MAX]; size_t begin, end; int accepted; } Incoming;
typedef struct { uint8_t bytes[LINK_UP_MAX]; size_t count; } Outgoing;

static const int UARTS[LINK_PORTS] = LINK_UARTS;
static Socket sockets[COUNT];
static Incoming incoming[LINK_PORTS];
static Outgoing outgoing[LINK_PORTS];
static double state[LINK_STATE];
static struct { double time; uint16_t channels[LINK_CHANNELS]; } rc;
static int has_state, has_rc;
static float motors[LINK_MOTORS];
static uint32_t motor_messages;

static Socket *ours(int fd) { return fd >= FIRST && fd < FIRST + COUNT ? &sockets[fd - FIRST] : NULL; }

static int failed(int reason)
{
    errno = reason;
    return -1;
}

static int new_socket(int kind, int port)
{
    for (int i = 0; i < COUNT; i++)
        if (sockets[i].kind == FREE) {
            sockets[i] = (Socket){kind, port};
            return FIRST + i;
        }
    return failed(EMFILE);
}

static int place_of(int port) /* of a serial port among those that can be talked to, -1 for another */
{
    for (int i = 0; i < LINK_PORTS; i++)
        if (port == PORT_SERIAL + UARTS[i])
            return i;
    return -1;
}

static size_t waiting(int place) { return incoming[place].end - incoming[place].begin; }

static int readable(const Socket *socket)
{
    const int place = place_of(socket->port);
    if (socket->kind == DATAGRAM)
        return socket->port == PORT_STATE ? has_state : socket->port == PORT_RC && has_rc;
    if (place < 0)
        return 0;
    return waiting(place) > 0 && incoming[place].accepted == (socket->kind == CONNECTION);
}

/* ---- the world's side ---- */

void sockets_deliver(const LinkDown *down)
{
    const uint8_t *from = down->serial;
    if (down->has & LINK_HAS_STATE)
        memcpy(state, down->state, sizeof state), has_state = 1;
    if (down->has & LINK_HAS_RC)
        rc.time = down->rc_time, memcpy(rc.channels, down->rc, sizeof rc.channels), has_rc = 1;
    for (int i = 0; i < LINK_PORTS; i++) {
        Incoming *in = &incoming[i];
        memmove(in->bytes, in->bytes + in->begin, waiting(i));
        in->end -= in->begin, in->begin = 0;
        const size_t room = sizeof in->bytes - in->end;
        const size_t fits = down->serial_bytes[i] < room ? down->serial_bytes[i] : room;
        memcpy(in->bytes + in->end, from, fits);
        in->end += fits, from += down->serial_bytes[i];
    }
}

void sockets_collect(LinkUp *up)
{
    size_t used = 0;
    up->motor_messages = motor_messages, motor_messages = 0;
    memcpy(up->motors, motors, sizeof motors);
    for (int i = 0; i < LINK_PORTS; i++) {
        const size_t count = outgoing[i].count < LINK_UP_MAX - used ? outgoing[i].count : LINK_UP_MAX - used;
        memcpy(up->serial + used, outgoing[i].bytes, count);
        memmove(outgoing[i].bytes, outgoing[i].bytes + count, outgoing[i].count - count);
        outgoing[i].count -= count, up->serial_bytes[i] = (uint32_t)count, used += count;
    }
}

/* ---- the firmware's side ---- */

EXPORT int socket(int domain, int type, int protocol)
{
    (void)domain, (void)protocol;
    return new_socket((type & 0xF) == SOCK_DGRAM ? DATAGRAM : LISTENER, 0);
}

EXPORT int bind(int fd, const struct sockaddr *address, socklen_t size)
{
    (void)size;
    Socket *socket = ours(fd);
    if (socket == NULL)
        return failed(EBADF);
    const struct sockaddr_in6 *six = (const struct sockaddr_in6 *)address;
    socket->port = ntohs(address->sa_family == AF_INET6 ? six->sin6_port
                                                        : ((const struct sockaddr_in *)address)->sin_port);
    return 0;
}

EXPORT int listen(int fd, int backlog)
{
    (void)backlog;
    return ours(fd) == NULL ? failed(EBADF) : 0;
}

EXPORT int accept(int fd, struct sockaddr *address, socklen_t *size)
{
    (void)address, (void)size;
    const Socket *socket = ours(fd);
    const int place = socket == NULL ? -1 : place_of(socket->port);
    if (place < 0 || incoming[place].accepted || waiting(place) == 0)
        return failed(EWOULDBLOCK);
    incoming[place].accepted = 1;
    return new_socket(CONNECTION, socket->port);
}

EXPORT ssize_t recv(int fd, void *into, size_t size, int flags)
{
    (void)flags;
    const Socket *socket = ours(fd);
    const int place = socket == NULL ? -1 : place_of(socket->port);
    if (place < 0 || waiting(place) == 0)
        return failed(EWOULDBLOCK);
    const size_t count = size < waiting(place) ? size : waiting(place);
    memcpy(into, incoming[place].bytes + incoming[place].begin, count);
    incoming[place].begin += count;
    return (ssize_t)count;
}

EXPORT ssize_t recvfrom(int fd, void *restrict into, size_t size, int flags, struct sockaddr *restrict from,
                        socklen_t *restrict from_size)
{
    (void)flags, (void)from, (void)from_size;
    const Socket *socket = ours(fd);
    if (socket == NULL || !readable(socket))
        return failed(EWOULDBLOCK);
    const void *packet = socket->port == PORT_STATE ? (const void *)state : (const void *)&rc;
    const size_t length = socket->port == PORT_STATE ? sizeof state : sizeof(double) + sizeof rc.channels;
    *(socket->port == PORT_STATE ? &has_state : &has_rc) = 0;
    memcpy(into, packet, size < length ? size : length);
    return (ssize_t)(size < length ? size : length);
}

EXPORT ssize_t send(int fd, const void *data, size_t size, int flags)
{
    (void)flags;
    const Socket *socket = ours(fd);
    const int place = socket == NULL ? -1 : place_of(socket->port);
    if (place < 0)
        return failed(EBADF);
    Outgoing *out = &outgoing[place];
    const size_t room = sizeof out->bytes - out->count, count = size < room ? size : room;
    if (count == 0)
        return failed(EWOULDBLOCK);
    memcpy(out->bytes + out->count, data, count);
    out->count += count;
    return (ssize_t)count;
}

EXPORT ssize_t sendto(int fd, const void *data, size_t size, int flags, const struct sockaddr *to, socklen_t to_size)
{
    (void)flags, (void)to_size;
    if (ours(fd) == NULL)
        return failed(EBADF);
    if (ntohs(((const struct sockaddr_in *)to)->sin_port) == PORT_MOTORS && size == sizeof motors)
        memcpy(motors, data, size), motor_messages++;
    return (ssize_t)size;
}

static int keep(int fd, fd_set *set, int (*ready)(const Socket *))
{
    const Socket *socket = ours(fd);
    if (set == NULL || !FD_ISSET(fd, set))
        return 0;
    if (socket != NULL && ready(socket))
        return 1;
    FD_CLR(fd, set);
    return 0;
}

int sockets_readable(int limit, const fd_set *read)
{
    for (int fd = FIRST; read != NULL && fd < limit; fd++)
        if (FD_ISSET(fd, read) && readable(&sockets[fd - FIRST]))
            return 1;
    return 0;
}

static int always(const Socket *socket) { return socket->kind != FREE; }
static int never(const Socket *socket) { return (void)socket, 0; }

/* A helper waits for data or as long as it says; data comes at gates only. */
EXPORT int select(int limit, fd_set *restrict read, fd_set *restrict write, fd_set *restrict except,
                  struct timeval *restrict patience)
{
    const uint64_t wait_ns = (uint64_t)patience->tv_sec * 1000000000u + (uint64_t)patience->tv_usec * 1000u;
    if (current_thread() != MAIN_THREAD)
        wait_in_main(clock_now_ns() + wait_ns, limit, read);
    int found = 0;
    for (int fd = FIRST; fd < limit; fd++)
        found += keep(fd, read, readable) + keep(fd, write, always) + keep(fd, except, never);
    return found;
}

EXPORT int close(int fd)
{
    Socket *socket = ours(fd);
    if (socket == NULL)
        return (int)syscall(SYS_close, fd);
    const int place = place_of(socket->port);
    if (socket->kind == CONNECTION && place >= 0)
        incoming[place].accepted = 0;
    socket->kind = FREE;
    return 0;
}

EXPORT int fcntl(int fd, int command, ...)
{
    va_list arguments;
    va_start(arguments, command);
    const long argument = va_arg(arguments, long);
    va_end(arguments);
    return ours(fd) != NULL ? 0 : (int)syscall(SYS_fcntl, fd, command, argument);
}

EXPORT int setsockopt(int fd, int level, int option, const void *value, socklen_t size)
{
    (void)fd, (void)level, (void)option, (void)value, (void)size;
    return 0;
}

EXPORT int getsockopt(int fd, int level, int option, void *restrict value, socklen_t *restrict size)
{
    (void)fd, (void)level, (void)option;
    memset(value, 0, *size);
    return 0;
}

EXPORT int getpeername(int fd, struct sockaddr *restrict address, socklen_t *restrict size)
{
    (void)fd, (void)address, (void)size;
    return failed(ENOTCONN);
}

EXPORT int getsockname(int fd, struct sockaddr *restrict address, socklen_t *restrict size)
{
    (void)fd, (void)address, (void)size;
    return failed(ENOTSOCK);
}
