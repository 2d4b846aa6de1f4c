/* The firmware's simulator packets: sensor readings as it wants them, motors as it gives them. */
#include <math.h>
#include <string.h>

#include "bridge.h"

static const double HOME_LAT_DEG = 47.3977419, HOME_LON_DEG = 8.5455938, HOME_ALT_M = 488.7858;
static const double METRES_PER_DEG = 111319.4907932;

static double pressure_pa(double height_m) /* international standard atmosphere */
{
    return 101325.0 * pow(1.0 - 2.25577e-5 * height_m, 5.25588);
}

static void hold(double *values, double *held, int32_t *is_held, int count, int stuck)
{
    if (stuck && !*is_held)
        memcpy(held, values, (size_t)count * sizeof *values);
    *is_held = stuck;
    if (stuck)
        memcpy(values, held, (size_t)count * sizeof *values);
}

static void put_inertial(Bridge *b, double *gyro, double *acc)
{
    memcpy(gyro, &READING(gyro_x_rps), 3 * sizeof *gyro);
    memcpy(acc, &READING(acc_x_mps2), 3 * sizeof *acc);
    hold(gyro, b->gyro_held, &b->gyro_is_held, 3, AT(gyro_stuck) != 0.0);
    hold(acc, b->acc_held, &b->acc_is_held, 3, AT(accelerometer_stuck) != 0.0);
    const double limit_rps = AT(gyro_limit_dps) * PI / 180.0;
    for (int i = 0; i < 3 && limit_rps > 0.0; i++)
        gyro[i] = clamp(gyro[i], -limit_rps, limit_rps);
    acc[0] = -acc[0]; /* the packet's x axis points backwards */
}

static void put_attitude(const Bridge *b, double *quaternion)
{
    const double r = 0.5 * TRUTH(roll_rad), p = 0.5 * TRUTH(pitch_rad), y = 0.5 * TRUTH(yaw_rad);
    const double cr = cos(r), sr = sin(r), cp = cos(p), sp = sin(p), cy = cos(y), sy = sin(y);
    quaternion[0] = cr * cp * cy + sr * sp * sy, quaternion[1] = sr * cp * cy - cr * sp * sy;
    quaternion[2] = cr * sp * cy + sr * cp * sy, quaternion[3] = cr * cp * sy - sr * sp * cy;
}

static void put_gps(Bridge *b, double *velocity, double *position)
{
    b->gps_drifted_m[0] += AT(gps_drift_north) * STEP_S, b->gps_drifted_m[1] += AT(gps_drift_east) * STEP_S;
    double fix[6] = {READING(gps_ve_mps), READING(gps_vn_mps), -READING(gps_vd_mps),
                     READING(gps_east_m) + b->gps_drifted_m[1], READING(gps_north_m) + b->gps_drifted_m[0],
                     READING(gps_up_m)};
    hold(fix, b->gps_held, &b->gps_is_held, 6, AT(gps_frozen) != 0.0);
    memcpy(velocity, fix, 3 * sizeof *fix);
    position[0] = HOME_LON_DEG + fix[3] / (METRES_PER_DEG * cos(HOME_LAT_DEG * PI / 180.0));
    position[1] = HOME_LAT_DEG + fix[4] / METRES_PER_DEG;
    position[2] = HOME_ALT_M + fix[5];
    AT(gps_altitude_m) = fix[5];
}

void packet_state(Bridge *b, double state[LINK_STATE])
{
    state[0] = 1.0; /* always the same: the firmware then takes its own clock for the simulator's */
    put_inertial(b, state + 1, state + 4);
    put_attitude(b, state + 7);
    put_gps(b, state + 11, state + 14);
    if (AT(baro_altitude_m) != READING(baro_m) || b->pressure_pa == 0.0)
        b->pressure_pa = pressure_pa(HOME_ALT_M + READING(baro_m));
    state[17] = b->pressure_pa;
    AT(baro_altitude_m) = READING(baro_m);
}

void packet_motors(Bridge *b, const float said[LINK_MOTORS], double throttles[MOTORS])
{
    const int pair = (int)AT(motor_swap), one = pair / 10 - 1, other = pair % 10 - 1;
    const double keep = AT(motor_lag_s) > 0.0 ? AT(motor_lag_s) / (AT(motor_lag_s) + STEP_S) : 0.0;
    for (int i = 0; i < MOTORS; i++) {
        const int from = pair == 0 ? i : i == one ? other : i == other ? one : i;
        b->lag[i] = keep * b->lag[i] + (1.0 - keep) * clamp(said[from], 0.0, 1.0);
        throttles[i] = b->lag[i];
    }
    AT(throttle) = 0.25 * (throttles[0] + throttles[1] + throttles[2] + throttles[3]);
}
