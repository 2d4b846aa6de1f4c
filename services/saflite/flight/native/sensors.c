/* Sizes of noise follow small consumer parts (MPU-6000 class inertial unit, MS5611 barometer, u-blox M8 receiver) and,
 * for the slow walk of the position, the 0.15 m that real avoidance flights scatter by.
 */
#include "sensors.h"

#include <math.h>
#include <string.h>

#include "noise.h"

#define AT(name) (s->at[SENSOR_##name])
#define FAULT(name) (s->at[FAULT_##name])
#define TRUTH(name) (truth[WORLD_##name])

static const double GYRO_NOISE = 0.003, ACC_NOISE = 0.05, BARO_NOISE = 0.06, COMPASS_NOISE = 0.002;
static const double GPS_NOISE = 0.04, GPS_UP_NOISE = 0.08, GPS_SPEED_NOISE = 0.04;
static const double GPS_WALK = 0.15, GPS_WALK_S = 25.0, BARO_WALK = 0.12, BARO_WALK_S = 60.0;
static const double GYRO_LEFT = 0.0001; /* what two seconds of averaging leave */
static const double SATELLITES = 10.0, SATELLITES_MAX = 14.0, SATELLITES_FIX = 4.0;
static const double RANGE_MAX_M = 40.0;
static const double EARTH_FIELD[3] = {0.2142, 0.0129, 0.4299}; /* gauss, north-east-down, Zurich (WMM 2020) */

static const char *const NAMES[] = {
#define SLOT_NAME(name) #name,
    SENSOR_READINGS(SLOT_NAME)
#undef SLOT_NAME
#define SLOT_NAME(name) "fault_" #name,
    SENSOR_FAULTS(SLOT_NAME)
#undef SLOT_NAME
};

const char *sensors_slot_name(int slot) { return slot >= 0 && slot < SENSOR_SLOT_COUNT ? NAMES[slot] : NULL; }
size_t sensors_size(void) { return sizeof(Sensors); }

void sensors_start(Sensors *s, const uint64_t rng_seeds[4])
{
    memset(s, 0, sizeof *s);
    s->rng_imu = rng_seeds[0], s->rng_baro = rng_seeds[1], s->rng_gps = rng_seeds[2], s->rng_compass = rng_seeds[3];
    FAULT(gps_satellites) = SATELLITES;
    for (int i = 0; i < 3; i++) {
        s->gyro_bias_rps[i] = 0.001 * noise_normal(&s->rng_imu);
        s->acc_bias_mps2[i] = 0.02 * noise_normal(&s->rng_imu);
        s->gyro_at_rest_rps[i] = s->gyro_bias_rps[i] + GYRO_LEFT * noise_normal(&s->rng_imu);
    }
}

static void read_imu(Sensors *s, const double *truth)
{
    const double gyro_noise = GYRO_NOISE + FAULT(gyro_noise), acc_noise = ACC_NOISE + FAULT(accelerometer_noise);
    for (int i = 0; i < 3; i++) {
        s->at[SENSOR_gyro_x_rps + i] = truth[WORLD_roll_rate_rps + i] + s->gyro_bias_rps[i]
                                     + gyro_noise * noise_normal(&s->rng_imu) + s->at[FAULT_gyro_offset_x + i];
        s->at[SENSOR_acc_x_mps2 + i] = truth[WORLD_force_x_mps2 + i] + s->acc_bias_mps2[i]
                                     + acc_noise * noise_normal(&s->rng_imu) + s->at[FAULT_accelerometer_offset_x + i];
    }
}

static double walk(double value, double size, double time_s, double every_s, uint64_t *rng)
{
    double keep = 1.0 - every_s / time_s;
    return keep * value + size * sqrt(1.0 - keep * keep) * noise_normal(rng);
}

static void read_baro(Sensors *s, const double *truth)
{
    const double every_s = STEPS_PER_BARO * STEP_S;
    s->baro_walk_m = walk(s->baro_walk_m, BARO_WALK, BARO_WALK_S, every_s, &s->rng_baro);
    s->baro_drifted_m += FAULT(baro_drift) * every_s;
    double noise = (BARO_NOISE + FAULT(baro_noise)) * noise_normal(&s->rng_baro);
    AT(baro_alive) = FAULT(baro_loss) != 0.0 ? 0.0 : 1.0;
    if (AT(baro_alive) != 0.0)
        AT(baro_m) = TRUTH(altitude_m) + s->baro_walk_m + s->baro_drifted_m + FAULT(baro_offset) + noise;
}

static void read_compass(Sensors *s, const double *truth)
{
    const double cr = cos(TRUTH(roll_rad)), sr = sin(TRUTH(roll_rad)), cp = cos(TRUTH(pitch_rad));
    const double sp = sin(TRUTH(pitch_rad)), cy = cos(TRUTH(yaw_rad)), sy = sin(TRUTH(yaw_rad));
    const double n = EARTH_FIELD[0], e = EARTH_FIELD[1], d = EARTH_FIELD[2];
    const double field[3] = {
        cp * cy * n + cp * sy * e - sp * d,
        (sr * sp * cy - cr * sy) * n + (sr * sp * sy + cr * cy) * e + sr * cp * d,
        (cr * sp * cy + sr * sy) * n + (cr * sp * sy - sr * cy) * e + cr * cp * d,
    };
    for (int i = 0; i < 3; i++)
        s->at[SENSOR_compass_x_gauss + i] = field[i]
                                          + (COMPASS_NOISE + FAULT(compass_noise)) * noise_normal(&s->rng_compass)
                                          + s->at[FAULT_compass_offset_x + i];
}

static void read_gps(Sensors *s, const double *truth)
{
    const double every_s = STEPS_PER_GPS * STEP_S;
    const double sats = clamp(FAULT(gps_satellites), 0.0, SATELLITES_MAX);
    const double spread = (sats >= 9.0 ? 1.0 : 1.0 + 0.35 * (9.0 - sats)); /* fewer satellites, poorer geometry */
    double white[6];
    for (int i = 0; i < 3; i++)
        s->gps_walk_m[i] = walk(s->gps_walk_m[i], GPS_WALK * spread, GPS_WALK_S, every_s, &s->rng_gps);
    for (int i = 0; i < 6; i++)
        white[i] = noise_normal(&s->rng_gps) * spread;
    s->gps_drifted_m += FAULT(gps_height_drift) * every_s;
    AT(gps_satellites) = FAULT(gps_loss) != 0.0 ? 0.0 : sats;
    if (AT(gps_satellites) < SATELLITES_FIX)
        return; /* no fix: the last reading stays */
    const double place = GPS_NOISE + FAULT(gps_noise), height = GPS_UP_NOISE + FAULT(gps_noise);
    const double speed = GPS_SPEED_NOISE + 0.1 * FAULT(gps_noise);
    AT(gps_north_m) = TRUTH(x_m) + s->gps_walk_m[0] + place * white[0] + FAULT(gps_offset_north);
    AT(gps_east_m) = TRUTH(y_m) + s->gps_walk_m[1] + place * white[1] + FAULT(gps_offset_east);
    AT(gps_up_m) = TRUTH(altitude_m) + 2.0 * s->gps_walk_m[2] + height * white[2] + FAULT(gps_offset_up)
                 + s->gps_drifted_m;
    AT(gps_vn_mps) = TRUTH(vx_mps) + speed * white[3];
    AT(gps_ve_mps) = TRUTH(vy_mps) + speed * white[4];
    AT(gps_vd_mps) = -TRUTH(climb_mps) + speed * white[5] - FAULT(gps_height_drift);
}

/* A four-cell 5.2 Ah pack: open voltage falls linearly with use, 20 mOhm inside. */
static void read_battery(Sensors *s, const double *truth)
{
    double amps = 0.4;
    for (int i = 0; i < MOTORS; i++)
        amps += 11.0 * truth[WORLD_command_1 + i] * truth[WORLD_command_1 + i];
    AT(pack_a) = amps;
    AT(pack_used_mah) += amps * (STEPS_PER_BARO * STEP_S) / 3.6;
    const double open_v = FAULT(battery_voltage) > 0.0 ? FAULT(battery_voltage)
                                                       : 16.8 - 2.4 * AT(pack_used_mah) / 5200.0;
    AT(pack_v) = open_v - 0.02 * amps;
}

static void read_range(Sensors *s, const double *truth)
{
    const double slope = cos(TRUTH(roll_rad)) * cos(TRUTH(pitch_rad)), range_m = TRUTH(altitude_m) / slope;
    AT(rangefinder_m) = slope > 0.3 && range_m < RANGE_MAX_M ? range_m : RANGE_MAX_M;
}

void sensors_read(Sensors *s, const double truth[WORLD_SLOT_COUNT])
{
    const int64_t step = (int64_t)TRUTH(step);
    read_imu(s, truth);
    if (step % STEPS_PER_BARO == 0) {
        read_baro(s, truth);
        read_battery(s, truth);
        read_range(s, truth);
    }
    if (step % STEPS_PER_GPS == 0) {
        read_gps(s, truth);
        read_compass(s, truth);
    }
}
