/* The firmware's own word, asked for in turn on a serial port of its own: MSP version 1. */
#include <string.h>

#include "bridge.h"

enum { MSP_STATUS_EX = 150, MSP_ALTITUDE = 109, MSP_RC = 105 };
enum { FLAG_RUNAWAY = 1 << 5, FLAG_CRASH = 1 << 6 }; /* of the arming flags */
enum { IDLE, DOLLAR, M, DIRECTION, SIZE, COMMAND, PAYLOAD };
enum { MODE_ANGLE = 0, MODE_ACRO = 1, MODE_ALTITUDE_HOLD = 2, MODE_RESCUE = 6, MODE_POSITION_HOLD = 16,
       MODE_HORIZON = 30, MODE_FAILSAFE = 31 };

int msp_frame(uint8_t *into, int command, const uint8_t *payload, int size)
{
    uint8_t sum = (uint8_t)(size ^ command);
    memcpy(into, "$M<", 3);
    into[3] = (uint8_t)size, into[4] = (uint8_t)command;
    for (int i = 0; i < size; i++)
        into[5 + i] = payload[i], sum ^= payload[i];
    into[5 + size] = sum;
    return 6 + size;
}

void telemetry_poll(Bridge *b)
{
    static const int TURN[4] = {MSP_STATUS_EX, MSP_ALTITUDE, MSP_STATUS_EX, MSP_RC};
    uint8_t *into = b->pending[PORT_TELEMETRY] + b->pending_bytes[PORT_TELEMETRY];
    if (b->pending_bytes[PORT_TELEMETRY] < 64)
        b->pending_bytes[PORT_TELEMETRY] += msp_frame(into, TURN[b->polls++ % 4], NULL, 0);
}

static uint32_t little(const uint8_t *from, int bytes)
{
    uint32_t value = 0;
    for (int i = 0; i < bytes; i++)
        value |= (uint32_t)from[i] << (8 * i);
    return value;
}

static int box(const Bridge *b, int which, const uint8_t *low, const uint8_t *high, int high_bytes)
{
    const int bit = b->box_bits[which];
    if (bit < 0 || bit >= 32 + 8 * high_bytes)
        return 0;
    return bit < 32 ? low[bit / 8] >> (bit % 8) & 1 : high[(bit - 32) / 8] >> (bit % 8) & 1;
}

static double mode_of(const Bridge *b)
{
    if (AT(box_rescue) != 0.0)
        return MODE_RESCUE;
    if (AT(failsafe_radio) != 0.0)
        return MODE_FAILSAFE;
    if (AT(box_position_hold) != 0.0)
        return MODE_POSITION_HOLD;
    if (AT(box_altitude_hold) != 0.0)
        return MODE_ALTITUDE_HOLD;
    if (AT(box_angle) != 0.0)
        return MODE_ANGLE;
    return AT(box_horizon) != 0.0 ? MODE_HORIZON : MODE_ACRO;
}

static void read_status(Bridge *b, const uint8_t *p, int size)
{
    const int high_bytes = size > 15 ? p[15] & 15 : 0, flags = 16 + high_bytes;
    if (size < flags + 5)
        return;
    const uint8_t *low = p + 6, *high = p + 16;
    AT(armed) = box(b, BOX_ARM, low, high, high_bytes);
    AT(box_angle) = box(b, BOX_ANGLE, low, high, high_bytes);
    AT(box_horizon) = box(b, BOX_HORIZON, low, high, high_bytes);
    AT(box_altitude_hold) = box(b, BOX_ALTITUDE_HOLD, low, high, high_bytes);
    AT(box_position_hold) = box(b, BOX_POSITION_HOLD, low, high, high_bytes);
    AT(box_rescue) = box(b, BOX_RESCUE, low, high, high_bytes);
    const int called_for = AT(box_rescue) != 0.0 && b->rescue_asked_s <= 0.0; /* by the failsafe, not by the pilot */
    AT(failsafe_radio) = box(b, BOX_FAILSAFE, low, high, high_bytes) || called_for;
    AT(mode) = mode_of(b);
    const uint32_t forbidden = little(p + flags + 1, 4), latch = 1u << (p[flags] > 0 ? p[flags] - 1 : 0);
    AT(arming_flags) = forbidden;
    AT(runaway_stopped) = (forbidden & FLAG_RUNAWAY) != 0, AT(crash_stopped) = (forbidden & FLAG_CRASH) != 0;
    AT(arming_forbidden) = (forbidden & ~latch) != 0;
    AT(telemetry_age_s) = 0.0;
}

static void read_answer(Bridge *b, const MspReader *r)
{
    const uint8_t *p = r->payload;
    if (r->command == MSP_STATUS_EX)
        read_status(b, p, r->size);
    if (r->command == MSP_ALTITUDE && r->size >= 6) {
        AT(altitude_est_m) = (int32_t)little(p, 4) / 100.0;
        AT(climb_est_mps) = (int16_t)little(p + 4, 2) / 100.0;
    }
    if (r->command == MSP_RC && r->size >= 8) {
        AT(rx_roll_us) = little(p, 2), AT(rx_pitch_us) = little(p + 2, 2);
        AT(rx_yaw_us) = little(p + 4, 2), AT(rx_throttle_us) = little(p + 6, 2);
    }
}

static void read_byte(Bridge *b, MspReader *r, uint8_t byte)
{
    switch (r->state) {
    case IDLE: r->state = byte == '$' ? DOLLAR : IDLE; break;
    case DOLLAR: r->state = byte == 'M' ? M : IDLE; break;
    case M: r->state = byte == '>' ? DIRECTION : IDLE; break;
    case DIRECTION: r->size = byte, r->sum = byte, r->count = 0, r->state = SIZE; break;
    case SIZE: r->command = byte, r->sum ^= byte, r->state = PAYLOAD; break;
    default:
        if (r->count < r->size) {
            r->payload[r->count++] = byte, r->sum ^= byte;
            break;
        }
        r->state = IDLE;
        if (byte == r->sum)
            read_answer(b, r);
    }
}

void telemetry_read(Bridge *b, const uint8_t *bytes, int count)
{
    for (int i = 0; i < count; i++)
        read_byte(b, &b->reader, bytes[i]);
}
