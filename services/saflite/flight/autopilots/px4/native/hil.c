#include "hil.h"

#include <errno.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <sys/socket.h>

enum { STEPS_PER_MESSAGE = 2, STEPS_PER_RADIO = 8 };
enum { STARTING_MS = 4, MISS_MS = 4, MISS_MAX_MS = 250, IN_ROW_MAX = 6, QUIET_MAX = 100 }; /* half a simulated second */
static const uint64_t STEP_US = 2500, BEGIN_US = 1000000;
static const double LANDED_M = 0.1, UPRIGHT = 0.93, SETTLED_MPS = 1.5; /* cosine of 21 degrees */

static const char *const NAMES[] = {
#define SLOT_NAME(name) #name,
    PX4_SLOTS(SLOT_NAME)
#undef SLOT_NAME
};

#define TRUTH(name) (p->world.at[WORLD_##name])

const char *px4_slot_name(int slot) { return slot >= 0 && slot < PX4_SLOT_COUNT ? NAMES[slot] : NULL; }
size_t px4_size(void) { return (sizeof(Px4) + 7) / 8 * 8; }
size_t px4_offset(int part) /* of the world 0, of the sensors 1, of the slots here 2 */
{
    return part == 0 ? offsetof(Px4, world) : part == 1 ? offsetof(Px4, sensors) : offsetof(Px4, at);
}

void px4_connect(Px4 *p, int tcp, int udp, int silent_ms, const double home[3], int own_physics)
{
    p->tcp = tcp, p->udp = udp, p->silent_ms = silent_ms, p->own_physics = own_physics;
    p->answered_us = 0, p->in_row = IN_ROW_MAX, p->quiet = 0, p->held_bytes = p->said_bytes = 0;
    memcpy(p->home, home, sizeof p->home);
}

void px4_record(Px4 *p, float *rows, const int32_t *columns, int column_count, int row_limit, int steps_per_row)
{
    p->recorder = (Recorder){rows, columns, column_count, row_limit, 0, steps_per_row};
    recorder_row(&p->recorder, (const double *)p);
}

int px4_rows(const Px4 *p) { return p->recorder.row_count; }
int px4_answers(const Px4 *p) { return p->answered_us > 0; }

/* The truth was written by whoever hears it: distances to boxes anew, and the end at one. */
void px4_follow(Px4 *p) { world_follow(&p->world); }

/* Take what was said to the ground station; returns the number of bytes. */
int px4_heard(Px4 *p, uint8_t *into)
{
    const uint32_t count = p->said_bytes;
    memcpy(into, p->said, count);
    p->said_bytes = 0;
    return (int)count;
}

static void drain_ground(Px4 *p)
{
    for (;;) {
        if (p->said_bytes + PX4_BUFFER > PX4_SAID_MAX)
            return; /* nobody listens: datagrams may get lost */
        const ssize_t got = recv(p->udp, p->said + p->said_bytes, PX4_BUFFER, MSG_DONTWAIT);
        if (got <= 0)
            return;
        p->said_bytes += (uint32_t)got;
    }
}

static int hear(Px4 *p)
{
    const ssize_t got = recv(p->tcp, p->held + p->held_bytes, PX4_BUFFER - p->held_bytes, MSG_DONTWAIT);
    if (got < 0)
        return errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR ? PX4_OK : PX4_GONE;
    if (got == 0)
        return PX4_GONE;
    p->held_bytes += (uint32_t)got;
    const int done = hil_take(p, p->held, (int)p->held_bytes);
    p->held_bytes -= (uint32_t)done;
    memmove(p->held, p->held + done, p->held_bytes);
    return PX4_OK;
}

/* Nothing was heard for many heartbeats' time: no more simulated time until it says something, on either link. */
static int await_word(Px4 *p)
{
    struct pollfd both[2] = {{p->tcp, POLLIN, 0}, {p->udp, POLLIN, 0}};
    p->quiet = 0;
    return poll(both, 2, p->silent_ms) > 0 ? PX4_OK : PX4_SILENT;
}

static int miss(Px4 *p)
{
    const uint32_t before = p->said_bytes;
    if (p->answered_us == 0)
        return PX4_OK;
    drain_ground(p);
    p->in_row = 0;
    p->quiet = p->said_bytes == before ? p->quiet + 1 : 0;
    return p->quiet > QUIET_MAX ? await_word(p) : PX4_OK;
}

/* How long to wait for motor commands: the longer the more it has given in a row. Who waited as long after each one that
 * came would wait for nearly all the others of a PX4 that gives one now and then (accelerometer switched off, say). */
static int patience_ms(const Px4 *p)
{
    const int ms = p->answered_us == 0 ? STARTING_MS : MISS_MS << p->in_row;
    return ms < MISS_MAX_MS ? ms : MISS_MAX_MS;
}

/* Wait for the motor commands of a time. PX4 gives none before all its modules run, and none while nothing reaches its
 * rate controller (gyros switched off, say): its clock must go on all the same, so after a while we do without. */
static int await(Px4 *p, uint64_t time_us)
{
    const int missed = patience_ms(p);
    struct pollfd link = {p->tcp, POLLIN, 0};
    while (p->answered_us < time_us) {
        const int ready = poll(&link, 1, missed);
        if (ready < 0 && errno == EINTR)
            continue;
        if (ready <= 0)
            return miss(p);
        const int trouble = hear(p);
        if (trouble != PX4_OK)
            return trouble;
    }
    p->in_row += p->in_row < IN_ROW_MAX;
    p->quiet = 0;
    return PX4_OK;
}

static int tell(Px4 *p)
{
    uint8_t frames[3 * FRAME_MAX];
    const int64_t step = (int64_t)TRUTH(step);
    const uint64_t time_us = BEGIN_US + (uint64_t)step * STEP_US;
    int bytes = 0;
    /* receivers fall silent, they say nothing wrong */
    if (step % STEPS_PER_GPS == 0 && p->sensors.at[FAULT_gps_loss] == 0.0)
        bytes += hil_gps(p, time_us, frames + bytes);
    if (step % STEPS_PER_RADIO == 0 && p->at[P_rc_silent] == 0.0)
        bytes += hil_radio(p, time_us, frames + bytes);
    const int pressure = step % STEPS_PER_BARO == 0 && p->sensors.at[SENSOR_baro_alive] != 0.0;
    bytes += hil_sensor(p, time_us, pressure, step % STEPS_PER_GPS == 0, frames + bytes);
    p->sequence++;
    struct pollfd link = {p->tcp, POLLOUT, 0};
    if (poll(&link, 1, p->silent_ms) <= 0)
        return PX4_SILENT;
    if (send(p->tcp, frames, (size_t)bytes, MSG_NOSIGNAL) != bytes)
        return PX4_GONE;
    return await(p, time_us);
}

/* A vehicle that came down upright and slow with motors off stands: the gear's contact would go on to tip it over. */
static void settle(Px4 *p)
{
    const double running = p->throttles[0] + p->throttles[1] + p->throttles[2] + p->throttles[3];
    const double speed_mps = fabs(TRUTH(vx_mps)) + fabs(TRUTH(vy_mps)) + fabs(TRUTH(climb_mps));
    const int upright = cos(TRUTH(roll_rad)) * cos(TRUTH(pitch_rad)) > UPRIGHT;
    p->at[P_throttle] = running / MOTORS;
    if (TRUTH(world_state) == WORLD_FLYING && running == 0.0 && TRUTH(altitude_m) < LANDED_M && upright
        && speed_mps < SETTLED_MPS)
        TRUTH(world_state) = WORLD_STANDING;
}

/* Wait for the gate's word: its step is over, PX4 waits for us. */
static int await_gate(Px4 *p)
{
    uint32_t over;
    struct pollfd gate = {p->tcp, POLLIN, 0};
    for (;;) {
        const int ready = poll(&gate, 1, p->silent_ms);
        if (ready < 0 && errno == EINTR)
            continue;
        if (ready <= 0)
            return PX4_SILENT;
        return recv(p->tcp, &over, sizeof over, MSG_DONTWAIT) == (ssize_t)sizeof over ? PX4_OK : PX4_GONE;
    }
}

/* Have PX4's own physics run one of its steps of 5 ms; each is ordered apart, so that all its threads are done with it. */
static int let_run(Px4 *p)
{
    const uint32_t one = 1;
    if (send(p->tcp, &one, sizeof one, MSG_NOSIGNAL) != (ssize_t)sizeof one)
        return PX4_GONE;
    const int trouble = await_gate(p);
    if (trouble != PX4_OK)
        return trouble;
    TRUTH(step) += STEPS_PER_MESSAGE, TRUTH(time_s) = TRUTH(step) * STEP_S;
    recorder_step(&p->recorder, (const double *)p, (int64_t)TRUTH(step));
    return PX4_OK;
}

static int run_own(Px4 *p, int steps)
{
    for (int i = 0; i < steps && TRUTH(world_state) != WORLD_CRASHED; i += STEPS_PER_MESSAGE) {
        const int trouble = let_run(p);
        if (trouble != PX4_OK)
            return trouble;
    }
    drain_ground(p);
    return PX4_OK;
}

/* Run steps of 2.5 ms; ends early in trouble, or when the world has crashed. */
int px4_run(Px4 *p, int steps)
{
    if (p->own_physics)
        return run_own(p, steps);
    for (int i = 0; i < steps && TRUTH(world_state) != WORLD_CRASHED; i++) {
        if (world_step(&p->world, p->throttles))
            return PX4_PYTHON;
        sensors_read(&p->sensors, p->world.at);
        settle(p);
        recorder_step(&p->recorder, (const double *)p, (int64_t)TRUTH(step));
        const int trouble = (int64_t)TRUTH(step) % STEPS_PER_MESSAGE == 0 ? tell(p) : PX4_OK;
        if (trouble != PX4_OK)
            return trouble;
    }
    drain_ground(p);
    return PX4_OK;
}
