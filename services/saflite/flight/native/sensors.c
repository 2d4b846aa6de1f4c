/* Sensors: truth to readings, with seeded noise, slow walks, lever arms, calibration offsets and injected faults.
 *
 * Sizes of noise follow small consumer parts (MPU-6000 class inertial unit, MS5611 barometer, u-blox M8 receiver) and,
 * for the slow walk of the position, the 0.15 m that real avoidance flights scatter by.
 */
#include <math.h>

#include "noise.h"
#include "vehicle.h"

#define AT(name) (v->at[S_##name])

static const double GYRO_NOISE = 0.003, ACC_NOISE = 0.05, BARO_NOISE = 0.06, MAG_NOISE = 0.002;
static const double GPS_NOISE = 0.04, GPS_UP_NOISE = 0.08, GPS_SPEED_NOISE = 0.04;
static const double GPS_WALK = 0.15, GPS_WALK_S = 25.0, BARO_WALK = 0.12, BARO_WALK_S = 60.0;
static const double GYRO_LEFT = 0.0001; /* what two seconds of averaging leave */
static const double OFFSET_CREEP_MPS = 0.3; /* a changed offset creeps in, as in AP_Baro */
static const double EARTH_FIELD[3] = {0.2142, 0.0129, 0.4299}; /* gauss, north-east-down, Zurich (WMM 2020) */

void sensors_start(Vehicle *v)
{
    for (int i = 0; i < 3; i++) {
        v->true_gyro_bias[i] = 0.001 * noise_normal(&v->rng_imu);
        v->true_acc_bias[i] = 0.02 * noise_normal(&v->rng_imu);
        v->gyro_bias[i] = v->true_gyro_bias[i] + GYRO_LEFT * noise_normal(&v->rng_imu); /* calibrated at start-up */
        v->gps_walk[i] = 0.0;
    }
    v->baro_walk = 0.0;
    AT(battery_used_mah) = 0.0;
    v->range_m = 0.0;
}

void sensors_imu(Vehicle *v)
{
    const double gyro_noise = GYRO_NOISE + AT(fault_gyro_noise), acc_noise = ACC_NOISE + AT(fault_acc_noise);
    for (int i = 0; i < 3; i++) {
        v->at[S_gyro_x + i] = v->at[S_p_rps + i] + v->true_gyro_bias[i] + gyro_noise * noise_normal(&v->rng_imu)
                            + v->at[S_fault_gyro_x + i] - v->at[S_cal_gyr_x + i];
        v->at[S_acc_x + i] = v->at[S_force_x + i] + v->true_acc_bias[i] + acc_noise * noise_normal(&v->rng_imu)
                           + v->at[S_fault_acc_x + i] - v->at[S_cal_acc_x + i];
    }
}

static double walk(double value, double size, double time_s, double every_s, uint64_t *rng)
{
    double keep = 1.0 - every_s / time_s;
    return keep * value + size * sqrt(1.0 - keep * keep) * noise_normal(rng);
}

static void read_baro(Vehicle *v)
{
    const double every_s = STEPS_PER_STATE * STEP_S;
    v->baro_walk = walk(v->baro_walk, BARO_WALK, BARO_WALK_S, every_s, &v->rng_baro);
    v->baro_drifted += AT(fault_baro_drift) * every_s;
    double noise = (BARO_NOISE + AT(fault_baro_noise)) * noise_normal(&v->rng_baro);
    const double creep = OFFSET_CREEP_MPS * every_s;
    v->baro_offset += clamp(AT(baro_alt_offset) - v->baro_offset, -creep, creep);
    AT(baro_ok) = AT(fault_baro_off) != 0.0 ? 0.0 : 1.0;
    if (AT(baro_ok) == 0.0)
        return;
    AT(baro_raw_m) = AT(up_m) + v->baro_walk + v->baro_drifted + AT(fault_baro_offset) + noise;
    AT(baro_altitude_m) = (AT(baro_raw_m) - AT(baro_ground_m)) * AT(baro_gain) + v->baro_offset;
}

static void read_compass(Vehicle *v)
{
    const double cr = cos(AT(phi)), sr = sin(AT(phi)), cp = cos(AT(theta)), sp = sin(AT(theta));
    const double cy = cos(AT(psi)), sy = sin(AT(psi));
    const double n = EARTH_FIELD[0], e = EARTH_FIELD[1], d = EARTH_FIELD[2];
    const double field[3] = {
        cp * cy * n + cp * sy * e - sp * d,
        (sr * sp * cy - cr * sy) * n + (sr * sp * sy + cr * cy) * e + sr * cp * d,
        (cr * sp * cy + sr * sy) * n + (cr * sp * sy - sr * cy) * e + cr * cp * d,
    };
    for (int i = 0; i < 3; i++)
        v->at[S_mag_x + i] = field[i] + (MAG_NOISE + AT(fault_mag_noise)) * noise_normal(&v->rng_mag)
                           + v->at[S_fault_mag_x + i] + v->at[S_cal_mag_x + i];
}

static void read_gps(Vehicle *v)
{
    const double every_s = STEPS_PER_GPS * STEP_S;
    const double sats = clamp(AT(fault_gps_sats), 0.0, 14.0);
    const double spread = (sats >= 9.0 ? 1.0 : 1.0 + 0.35 * (9.0 - sats)); /* fewer satellites, poorer geometry */
    double white[6];
    for (int i = 0; i < 3; i++)
        v->gps_walk[i] = walk(v->gps_walk[i], GPS_WALK * spread, GPS_WALK_S, every_s, &v->rng_gps);
    for (int i = 0; i < 6; i++)
        white[i] = noise_normal(&v->rng_gps) * spread;
    v->gps_drifted += AT(fault_gps_vdrift) * every_s;
    AT(gps_satellites) = AT(fault_gps_off) != 0.0 ? 0.0 : sats;
    AT(gps_ok) = AT(gps_satellites) >= AT(gps_sats_min) ? 1.0 : 0.0;
    if (AT(gps_satellites) < 4.0)
        return; /* no fix: the last reading stays */
    const double rough = AT(fault_gps_noise);
    AT(gps_north) = AT(north_m) + v->gps_walk[0] + (GPS_NOISE + rough) * white[0] + AT(fault_gps_north);
    AT(gps_east) = AT(east_m) + v->gps_walk[1] + (GPS_NOISE + rough) * white[1] + AT(fault_gps_east);
    AT(gps_up) = AT(up_m) + 2.0 * v->gps_walk[2] + (GPS_UP_NOISE + rough) * white[2] + AT(fault_gps_up) + v->gps_drifted;
    AT(gps_vn) = AT(v_north) + (GPS_SPEED_NOISE + 0.1 * rough) * white[3];
    AT(gps_ve) = AT(v_east) + (GPS_SPEED_NOISE + 0.1 * rough) * white[4];
    AT(gps_vd) = AT(v_down) + (GPS_SPEED_NOISE + 0.1 * rough) * white[5] - AT(fault_gps_vdrift);
    AT(gps_altitude_m) = AT(gps_up) - AT(home_up);
}

/* A four-cell 5.2 Ah pack: open voltage falls linearly with use, 20 mOhm inside. */
static void read_battery(Vehicle *v)
{
    const double every_s = STEPS_PER_STATE * STEP_S;
    double amps = 0.4;
    for (int i = 0; i < 4; i++)
        amps += 11.0 * v->motor[i] * v->motor[i];
    AT(battery_used_mah) += amps * every_s / 3.6;
    AT(battery_a) = amps * AT(battery_amp_scale);
    double open_v = 16.8 - 2.4 * AT(battery_used_mah) / 5200.0;
    double real = open_v - 0.02 * amps;
    AT(battery_v) = (AT(fault_battery_v) > 0.0 ? AT(fault_battery_v) - 0.02 * amps : real) * AT(battery_volt_scale);
}

void sensors_slow(Vehicle *v)
{
    read_baro(v);
    read_battery(v);
    double slope = cos(AT(phi)) * cos(AT(theta));
    AT(rangefinder_m) = slope > 0.3 && AT(up_m) / slope < 40.0 ? AT(up_m) / slope : 40.0;
    if (v->step % STEPS_PER_GPS == 0) {
        read_gps(v);
        read_compass(v);
    }
}
