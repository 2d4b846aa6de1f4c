#include "bridge.h"

#include <errno.h>
#include <math.h>
#include <string.h>
#include <sys/socket.h>

enum { STEPS_PER_FRAME = 8, SERIAL_PER_STEP = 64 }; /* RC and telemetry at 50 Hz; a link of 205 kbit/s */
static const double LANDED_M = 0.1, LANDED_MPS = 0.2, SWITCHED_ON_US = 1700.0, ASKED_S = 1.0;
static const double UPRIGHT = 0.93, SETTLED_MPS = 1.5; /* cosine of 21 degrees */

static const char *const NAMES[] = {
#define SLOT_NAME(name) #name,
    BRIDGE_SLOTS(SLOT_NAME)
#undef SLOT_NAME
};

enum { MSP_SET_RAW_RC = 200 };

const char *bridge_slot_name(int slot) { return slot >= 0 && slot < BRIDGE_SLOT_COUNT ? NAMES[slot] : NULL; }
size_t bridge_size(void) { return (sizeof(Bridge) + 7) / 8 * 8; }
size_t bridge_offset(int part) /* of the world 0, the sensors 1, the bridge's own slots 2 */
{
    return part == 0 ? offsetof(Bridge, world) : part == 1 ? offsetof(Bridge, sensors) : offsetof(Bridge, at);
}

void bridge_start(Bridge *b)
{
    for (int i = 0; i < BOX_COUNT; i++)
        b->box_bits[i] = -1;
    b->fd = -1;
}

void bridge_connect(Bridge *b, int fd) { b->fd = fd; }
void bridge_box(Bridge *b, int which, int bit) { b->box_bits[which] = bit; }
int bridge_pid(const Bridge *b) { return b->firmware_pid; }
int bridge_code(const Bridge *b) { return b->firmware_code; }
int bridge_rows(const Bridge *b) { return b->recorder.row_count; }
int bridge_idle(const Bridge *b, int port) { return b->pending_bytes[port] == 0; }

void bridge_record(Bridge *b, float *rows, const int32_t *columns, int column_count, int row_limit, int steps_per_row)
{
    b->recorder = (Recorder){rows, columns, column_count, row_limit, 0, steps_per_row};
    recorder_row(&b->recorder, (const double *)b);
}

/* Queue bytes for a serial port; -1 if there are too many. */
int bridge_say(Bridge *b, int port, const uint8_t *bytes, int count)
{
    if (b->pending_bytes[port] + count > PENDING_MAX)
        return -1;
    memcpy(b->pending[port] + b->pending_bytes[port], bytes, (size_t)count);
    b->pending_bytes[port] += count;
    return 0;
}

/* Take what a port has said since it was listened to; `listening` is a bit per port. */
int bridge_heard(Bridge *b, int port, uint8_t *into)
{
    const int count = b->said_bytes[port];
    memcpy(into, b->said[port], (size_t)count);
    b->said_bytes[port] = 0;
    return count;
}

void bridge_listen(Bridge *b, int ports) { b->listening = ports; }

static void send_radio(Bridge *b)
{
    uint8_t payload[2 * LINK_CHANNELS], frame[64];
    AT(rc_present) = AT(rc_link) != 0.0;
    AT(rc_valid) = AT(rc_present);
    for (int i = 0; i < 4; i++)
        if (!(b->at[B_rc_1 + i] >= AT(rx_min_set_us) && b->at[B_rc_1 + i] <= AT(rx_max_set_us)))
            AT(rc_valid) = 0.0;
    for (int i = 0; i < LINK_CHANNELS; i++) {
        const uint16_t pulse = (uint16_t)b->at[B_rc_1 + i];
        b->down.rc[i] = pulse;
        payload[2 * i] = (uint8_t)pulse, payload[2 * i + 1] = (uint8_t)(pulse >> 8);
    }
    AT(arm_switch) = AT(rc_5) >= SWITCHED_ON_US, AT(rescue_switch) = AT(rc_10) >= SWITCHED_ON_US;
    /* without a valid signal the firmware keeps the switches that it heard last */
    const int kept = AT(rc_valid) == 0.0 && b->rescue_asked_s >= ASKED_S;
    const int asked = kept || (AT(rc_present) != 0.0 && AT(rescue_switch) != 0.0);
    b->rescue_asked_s = asked ? ASKED_S : b->rescue_asked_s - STEPS_PER_FRAME * STEP_S;
    AT(failsafe_switch) = AT(rc_11) >= SWITCHED_ON_US;
    if (AT(rc_link) == 2.0)
        b->down.has |= LINK_HAS_RC;
    if (AT(rc_link) == 1.0)
        bridge_say(b, PORT_PILOT, frame, msp_frame(frame, MSP_SET_RAW_RC, payload, sizeof payload));
}

static size_t fill_serial(Bridge *b)
{
    size_t used = 0;
    for (int i = 0; i < LINK_PORTS; i++) {
        const int count = b->pending_bytes[i] < SERIAL_PER_STEP ? b->pending_bytes[i] : SERIAL_PER_STEP;
        memcpy(b->down.serial + used, b->pending[i], (size_t)count);
        memmove(b->pending[i], b->pending[i] + count, (size_t)(b->pending_bytes[i] - count));
        b->pending_bytes[i] -= count, b->down.serial_bytes[i] = (uint32_t)count, used += (size_t)count;
    }
    return used;
}

static int send_step(Bridge *b)
{
    const int frame = (int64_t)TRUTH(step) % STEPS_PER_FRAME == 0;
    b->down.kind = LINK_STEP, b->down.has = LINK_HAS_STATE;
    b->down.step_ns = (uint64_t)(STEP_S * 1e9 + 0.5);
    packet_state(b, b->down.state);
    if (frame)
        send_radio(b);
    if ((int64_t)TRUTH(step) % (STEPS_PER_FRAME / 2) == 0)
        telemetry_poll(b);
    const size_t bytes = offsetof(LinkDown, serial) + fill_serial(b);
    return send(b->fd, &b->down, bytes, MSG_NOSIGNAL) < 0 ? BRIDGE_GONE : BRIDGE_OK;
}

static void hear(Bridge *b)
{
    const uint8_t *from = b->up.serial;
    for (int i = 0; i < LINK_PORTS; i++) {
        const int count = (int)b->up.serial_bytes[i], room = SAID_MAX - b->said_bytes[i];
        if (i == PORT_TELEMETRY && !(b->listening >> i & 1))
            telemetry_read(b, from, count);
        if (b->listening >> i & 1) {
            memcpy(b->said[i] + b->said_bytes[i], from, (size_t)(count < room ? count : room));
            b->said_bytes[i] += count < room ? count : room;
        }
        from += count;
    }
}

/* Whether a word is whole and names a process. The memory it is made of may be spoilt: that is what is looked for. */
static int is_whole(const LinkUp *up, size_t bytes)
{
    size_t said = offsetof(LinkUp, serial);
    for (int i = 0; i < LINK_PORTS; i++) {
        if (up->serial_bytes[i] > LINK_UP_MAX)
            return 0;
        said += up->serial_bytes[i];
    }
    return said <= bytes && up->pid > 0; /* to be killed: 0 and less are groups of processes, ours among them */
}

/* Wait for the firmware's word on the last step (or on having been forked). */
int bridge_await(Bridge *b)
{
    ssize_t got;
    do
        got = recv(b->fd, &b->up, sizeof b->up, 0);
    while (got < 0 && errno == EINTR);
    if (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK))
        return BRIDGE_SILENT;
    if (got < (ssize_t)offsetof(LinkUp, serial) || !is_whole(&b->up, (size_t)got))
        return BRIDGE_GONE;
    b->firmware_pid = b->up.pid, b->firmware_code = (int32_t)b->up.code;
    return b->up.kind == LINK_EXIT ? BRIDGE_EXITED : BRIDGE_OK;
}

static void show(Bridge *b)
{
    AT(home_distance_m) = sqrt(TRUTH(x_m) * TRUTH(x_m) + TRUTH(y_m) * TRUTH(y_m));
    AT(landed) = TRUTH(altitude_m) < LANDED_M && fabs(TRUTH(climb_mps)) < LANDED_MPS;
    AT(firmware_s) = (double)b->up.time_ns * 1e-9;
    AT(telemetry_age_s) += STEP_S;
}

/* A vehicle that came down upright and slow with motors off stands: the gear's contact would go on to tip it over. */
static void settle(Bridge *b, const double throttles[MOTORS])
{
    const double running = throttles[0] + throttles[1] + throttles[2] + throttles[3];
    const double speed_mps = fabs(TRUTH(vx_mps)) + fabs(TRUTH(vy_mps)) + fabs(TRUTH(climb_mps));
    const int upright = cos(TRUTH(roll_rad)) * cos(TRUTH(pitch_rad)) > UPRIGHT;
    if (TRUTH(world_state) == WORLD_FLYING && running == 0.0 && TRUTH(altitude_m) < LANDED_M && upright
        && speed_mps < SETTLED_MPS)
        TRUTH(world_state) = WORLD_STANDING;
}

static int step(Bridge *b)
{
    double throttles[MOTORS];
    sensors_read(&b->sensors, b->world.at);
    int trouble = send_step(b);
    if (trouble == BRIDGE_OK)
        trouble = bridge_await(b);
    if (trouble != BRIDGE_OK)
        return trouble;
    hear(b);
    packet_motors(b, b->up.motors, throttles);
    if (world_step(&b->world, throttles))
        return BRIDGE_PYTHON;
    settle(b, throttles);
    show(b);
    recorder_step(&b->recorder, (const double *)b, (int64_t)TRUTH(step));
    return BRIDGE_OK;
}

/* Run steps of 2.5 ms; ends early with a word other than BRIDGE_OK, or when the world has crashed. */
int bridge_run(Bridge *b, int steps)
{
    for (int i = 0; i < steps && TRUTH(world_state) != WORLD_CRASHED; i++) {
        const int trouble = step(b);
        if (trouble != BRIDGE_OK)
            return trouble;
    }
    return BRIDGE_OK;
}
