#include "lockstep.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>

static const double LANDED_M = 0.1, UPRIGHT = 0.93, SETTLED_MPS = 1.5; /* cosine of 21 degrees */

static const char *const NAMES[] = {
#define SLOT_NAME(name) #name,
    LOCKSTEP_SLOTS(SLOT_NAME)
#undef SLOT_NAME
};

#define TRUTH(name) (l->world.at[WORLD_##name])

const char *lockstep_slot_name(int slot) { return slot >= 0 && slot < LOCKSTEP_SLOT_COUNT ? NAMES[slot] : NULL; }
size_t lockstep_size(void) { return (sizeof(Lockstep) + 7) / 8 * 8; }
size_t lockstep_offset(int part) /* of the world 0, of the slots here 1 */
{
    return part == 0 ? offsetof(Lockstep, world) : offsetof(Lockstep, at);
}

void lockstep_connect(Lockstep *l, int udp, int tcp, int silent_ms, int own_physics)
{
    l->udp = udp, l->tcp = tcp, l->silent_ms = silent_ms, l->heard_one = 0, l->said_bytes = 0;
    l->own_physics = own_physics;
}

/* The sockets are other ones now, each with a peer of its own. */
void lockstep_moved(Lockstep *l) { l->peer_bytes = 0; }

void lockstep_record(Lockstep *l, float *rows, const int32_t *columns, int column_count, int row_limit, int steps_per_row)
{
    l->recorder = (Recorder){rows, columns, column_count, row_limit, 0, steps_per_row};
    recorder_row(&l->recorder, (const double *)l);
}

int lockstep_rows(const Lockstep *l) { return l->recorder.row_count; }

/* Take what was said over MAVLink; returns the number of bytes. */
int lockstep_heard(Lockstep *l, uint8_t *into)
{
    const uint32_t count = l->said_bytes;
    memcpy(into, l->said, count);
    l->said_bytes = 0;
    return (int)count;
}

/* Read all that waits on the MAVLink link, so that its writer never stalls. */
static int drain(Lockstep *l)
{
    for (;;) {
        const ssize_t got = recv(l->tcp, l->said + l->said_bytes, SAID_MAX - l->said_bytes, MSG_DONTWAIT);
        if (got > 0)
            l->said_bytes += (uint32_t)got;
        else if (got < 0 && errno == EINTR)
            continue;
        else if (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK))
            return LOCKSTEP_OK;
        else
            return l->said_bytes >= SAID_MAX ? LOCKSTEP_ALIEN : LOCKSTEP_GONE;
    }
}

/* The gate's word: how many frames are over. */
static int gate_packet(const uint8_t *data, ssize_t bytes, uint32_t *frame)
{
    if (bytes != (ssize_t)sizeof *frame)
        return 0;
    memcpy(frame, data, sizeof *frame);
    return 1;
}

static int take_packet(Lockstep *l)
{
    uint8_t data[256];
    socklen_t size = sizeof l->peer;
    uint32_t frame;
    double throttles[MOTORS] = {0.0};
    const ssize_t got = recvfrom(l->udp, data, sizeof data, MSG_DONTWAIT, (struct sockaddr *)l->peer, &size);
    const int good = got > 0
        && (l->own_physics ? gate_packet(data, got, &frame) : servo_packet(data, (int)got, &frame, throttles));
    if (!good || (l->heard_one && frame == l->frame))
        return 0; /* a repeat: it was answered */
    l->peer_bytes = size, l->frame = frame, l->heard_one = 1;
    memcpy(l->throttles, throttles, sizeof throttles);
    return 1;
}

/* Wait for the outputs of the next frame; then the autopilot waits for us. */
int lockstep_await(Lockstep *l)
{
    struct pollfd both[2] = {{l->udp, POLLIN, 0}, {l->tcp, POLLIN, 0}};
    for (;;) {
        const int ready = poll(both, 2, l->silent_ms);
        if (ready < 0 && errno == EINTR)
            continue;
        if (ready <= 0)
            return LOCKSTEP_SILENT;
        const int trouble = both[1].revents ? drain(l) : LOCKSTEP_OK;
        if (trouble != LOCKSTEP_OK)
            return trouble;
        if (both[0].revents && take_packet(l))
            return LOCKSTEP_OK;
    }
}

/* A vehicle that came down upright and slow with motors off stands: the gear's contact would go on to tip it over. */
static void settle(Lockstep *l)
{
    const double running = l->throttles[0] + l->throttles[1] + l->throttles[2] + l->throttles[3];
    const double speed_mps = fabs(TRUTH(vx_mps)) + fabs(TRUTH(vy_mps)) + fabs(TRUTH(climb_mps));
    const int upright = cos(TRUTH(roll_rad)) * cos(TRUTH(pitch_rad)) > UPRIGHT;
    if (TRUTH(world_state) == WORLD_FLYING && running == 0.0 && TRUTH(altitude_m) < LANDED_M && upright
        && speed_mps < SETTLED_MPS)
        TRUTH(world_state) = WORLD_STANDING;
}

static int answer(Lockstep *l)
{
    char line[STATE_LINE_MAX];
    const int bytes = state_line(&l->world, line, sizeof line);
    if (bytes <= 0 || bytes >= STATE_LINE_MAX)
        return LOCKSTEP_ALIEN;
    const ssize_t sent = sendto(l->udp, line, (size_t)bytes, 0, (struct sockaddr *)l->peer, l->peer_bytes);
    return sent == bytes ? LOCKSTEP_OK : LOCKSTEP_GONE;
}

static int step(Lockstep *l)
{
    if (world_step(&l->world, l->throttles))
        return LOCKSTEP_PYTHON;
    settle(l);
    recorder_step(&l->recorder, (const double *)l, (int64_t)TRUTH(step));
    const int trouble = answer(l);
    return trouble == LOCKSTEP_OK ? lockstep_await(l) : trouble;
}

/* Have the autopilot's own physics run steps of 2.5 ms and wait until it says that they are over. */
static int let_run(Lockstep *l, int steps)
{
    const uint32_t frames = (uint32_t)steps;
    const ssize_t sent = sendto(l->udp, &frames, sizeof frames, 0, (struct sockaddr *)l->peer, l->peer_bytes);
    const int trouble = sent == (ssize_t)sizeof frames ? lockstep_await(l) : LOCKSTEP_GONE;
    if (trouble != LOCKSTEP_OK)
        return trouble;
    TRUTH(step) += steps, TRUTH(time_s) = TRUTH(step) * STEP_S;
    recorder_step(&l->recorder, (const double *)l, (int64_t)TRUTH(step));
    return drain(l);
}

/* Run steps of 2.5 ms and read what was said in them; ends early in trouble, or when the world has crashed. */
int lockstep_run(Lockstep *l, int steps)
{
    if (l->own_physics)
        return TRUTH(world_state) != WORLD_CRASHED ? let_run(l, steps) : drain(l);
    for (int i = 0; i < steps && TRUTH(world_state) != WORLD_CRASHED; i++) {
        const int trouble = step(l);
        if (trouble != LOCKSTEP_OK)
            return trouble;
    }
    return drain(l);
}
