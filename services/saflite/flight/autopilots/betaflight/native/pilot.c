/* A pilot who sees the vehicle: takes off, keeps it over its place heading north, and leaves the sticks that the test
 * case has taken. Every 20 ms. */
#include <math.h>

#include "bridge.h"

enum { ROLL, PITCH, THROTTLE, YAW };
static const double CENTRE_US = 1500.0, TRIM_MAX_US = 80.0, THROTTLE_LEAST_US = 1150.0, THROTTLE_MOST_US = 1800.0;
static const double CLIMB_MAX_MPS = 3.0, DESCENT_MAX_MPS = 1.5, CLIMB_PER_M = 1.0, US_PER_MPS = 90.0, US_PER_MPS2 = 8.0;
static const double LEAN_PER_M = 2.0, LEAN_PER_MPS = 5.0, LEAN_MAX_DEG = 15.0, US_PER_DEG = 8.3;
static const double YAW_US_PER_DEG = 2.0, YAW_MAX_US = 60.0, PILOT_STEP_S = 0.02;

static void put(Bridge *b, int taken, int stick, double pulse_us)
{
    if (!(taken >> stick & 1))
        b->at[B_rc_1 + stick] = rint(pulse_us);
}

static double throttle_us(Bridge *b, double altitude_m, double hover_us)
{
    const double wanted_mps = CLIMB_PER_M * (altitude_m - TRUTH(altitude_m));
    const double off_mps = clamp(wanted_mps, -DESCENT_MAX_MPS, CLIMB_MAX_MPS) - TRUTH(climb_mps);
    b->trim_us = clamp(b->trim_us + US_PER_MPS2 * off_mps * PILOT_STEP_S, -TRIM_MAX_US, TRIM_MAX_US);
    return clamp(hover_us + b->trim_us + US_PER_MPS * off_mps, THROTTLE_LEAST_US, THROTTLE_MOST_US);
}

/* Roll (right) and nose-down angles against the way to the place. */
static void lean(const Bridge *b, double *roll_deg, double *pitch_deg)
{
    const double north = -LEAN_PER_M * TRUTH(x_m) - LEAN_PER_MPS * TRUTH(vx_mps);
    const double east = -LEAN_PER_M * TRUTH(y_m) - LEAN_PER_MPS * TRUTH(vy_mps);
    const double size = hypot(north, east), share = size > LEAN_MAX_DEG ? LEAN_MAX_DEG / size : 1.0;
    const double cos_yaw = cos(TRUTH(yaw_rad)), sin_yaw = sin(TRUTH(yaw_rad));
    *roll_deg = share * (east * cos_yaw - north * sin_yaw), *pitch_deg = share * (north * cos_yaw + east * sin_yaw);
}

/* Move the sticks that are the pilot's; `taken` is a bit per stick that is not. What the autopilot holds by itself,
 * height or place, needs no hand. */
void bridge_pilot(Bridge *b, double altitude_m, double hover_us, int taken)
{
    const int rescue = AT(box_rescue) != 0.0;
    const int height_held = rescue || AT(box_altitude_hold) != 0.0, place_held = rescue || AT(box_position_hold) != 0.0;
    double roll_deg = 0.0, pitch_deg = 0.0, turn_us = 0.0;
    put(b, taken, THROTTLE, height_held ? hover_us : throttle_us(b, altitude_m, hover_us));
    if (!place_held) {
        lean(b, &roll_deg, &pitch_deg);
        double off_deg = fmod(TRUTH(yaw_deg) + 180.0, 360.0);
        off_deg += (off_deg < 0.0 ? 360.0 : 0.0) - 180.0;
        turn_us = clamp(-YAW_US_PER_DEG * off_deg, -YAW_MAX_US, YAW_MAX_US);
    }
    put(b, taken, ROLL, CENTRE_US + US_PER_DEG * roll_deg);
    put(b, taken, PITCH, CENTRE_US + US_PER_DEG * pitch_deg);
    put(b, taken, YAW, CENTRE_US + turn_us);
}
