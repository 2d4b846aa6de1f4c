/* Servo outputs in, vehicle state out: the two messages of the JSON backend. */
#include <stdio.h>
#include <string.h>

#include "lockstep.h"

enum { MAGIC_16 = 18458, MAGIC_32 = 29569, HEADER_BYTES = 8 };
static const double LOW_US = 1000.0, SPAN_US = 1000.0;
/* The backend cuts each time step to whole microseconds: exact steps of 2.5 ms would come out a microsecond short. */
static const double STRETCH = 1.0 + 4e-8;

#define AT(name) (w->at[WORLD_##name])

/* Layout `<HHI` magic, frame rate, frame count, then 16 or 32 pulses `<H` in us; 0 where it is none of these. */
int servo_packet(const uint8_t *data, int bytes, uint32_t *frame, double throttles[MOTORS])
{
    uint16_t magic, pulse;
    if (bytes < HEADER_BYTES)
        return 0;
    memcpy(&magic, data, sizeof magic);
    const int channels = magic == MAGIC_16 ? 16 : magic == MAGIC_32 ? 32 : 0;
    if (channels == 0 || bytes != HEADER_BYTES + 2 * channels)
        return 0;
    memcpy(frame, data + 4, sizeof *frame);
    for (int i = 0; i < MOTORS; i++) {
        memcpy(&pulse, data + HEADER_BYTES + 2 * i, sizeof pulse);
        throttles[i] = clamp((pulse - LOW_US) / SPAN_US, 0.0, 1.0);
    }
    return 1;
}

/* Units m, m/s, m/s2, rad, rad/s; north, east, down from home; body axes forward, right, down. No blank after a colon. */
int state_line(const World *w, char *into, int room)
{
    return snprintf(into, (size_t)room,
        "\n{\"timestamp\":%.12f,\"imu\":{\"gyro\":[%.9g,%.9g,%.9g],\"accel_body\":[%.9g,%.9g,%.9g]},"
        "\"position\":[%.9g,%.9g,%.9g],\"attitude\":[%.9g,%.9g,%.9g],\"velocity\":[%.9g,%.9g,%.9g]}\n",
        AT(step) * STEP_S * STRETCH, AT(roll_rate_rps), AT(pitch_rate_rps), AT(yaw_rate_rps), AT(force_x_mps2),
        AT(force_y_mps2), AT(force_z_mps2), AT(x_m), AT(y_m), -AT(altitude_m), AT(roll_rad), AT(pitch_rad), AT(yaw_rad),
        AT(vx_mps), AT(vy_mps), -AT(climb_mps));
}
