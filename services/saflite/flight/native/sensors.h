/* The sensors of any autopilot: truth to raw readings with seeded noise, slow walks and injected faults.
 *
 * Raw means as the part would give them: calibration, lever arms and units of an autopilot are the autopilot's. What is
 * read is `World.at[]` alone. All faults of `flight/sensors/faults.py` act here, whatever flies.
 */
#ifndef SAFLITE_SENSORS_H
#define SAFLITE_SENSORS_H

#include "world.h"

#define STEPS_PER_BARO 8 /* barometer, battery, range finder: 50 Hz */
#define STEPS_PER_GPS 40 /* GPS and compass: 10 Hz */

#define SENSOR_READINGS(X) \
    X(gyro_x_rps) X(gyro_y_rps) X(gyro_z_rps) X(acc_x_mps2) X(acc_y_mps2) X(acc_z_mps2) \
    X(compass_x_gauss) X(compass_y_gauss) X(compass_z_gauss) X(baro_m) X(baro_alive) \
    X(gps_north_m) X(gps_east_m) X(gps_up_m) X(gps_vn_mps) X(gps_ve_mps) X(gps_vd_mps) X(gps_satellites) \
    X(rangefinder_m) X(pack_v) X(pack_a) X(pack_used_mah)

#define SENSOR_FAULTS(X) \
    X(gps_loss) X(gps_satellites) X(gps_noise) X(gps_offset_north) X(gps_offset_east) X(gps_offset_up) \
    X(gps_height_drift) X(baro_loss) X(baro_offset) X(baro_drift) X(baro_noise) \
    X(compass_noise) X(compass_offset_x) X(compass_offset_y) X(compass_offset_z) \
    X(gyro_noise) X(gyro_offset_x) X(gyro_offset_y) X(gyro_offset_z) \
    X(accelerometer_noise) X(accelerometer_offset_x) X(accelerometer_offset_y) X(accelerometer_offset_z) \
    X(battery_voltage)

#define READING_ENUM(name) SENSOR_##name,
#define FAULT_ENUM(name) FAULT_##name,
enum { SENSOR_READINGS(READING_ENUM) SENSOR_READING_COUNT };
enum { FAULT_START = SENSOR_READING_COUNT - 1, SENSOR_FAULTS(FAULT_ENUM) SENSOR_SLOT_COUNT };
#undef READING_ENUM
#undef FAULT_ENUM

typedef struct {
    double at[SENSOR_SLOT_COUNT]; /* readings, then faults */
    double gyro_bias_rps[3], acc_bias_mps2[3];
    double gyro_at_rest_rps[3];   /* what two seconds of averaging before the start say of the gyros' bias */
    double baro_walk_m, baro_drifted_m, gps_walk_m[3], gps_drifted_m;
    uint64_t rng_imu, rng_baro, rng_gps, rng_compass; /* streams of their own: no sensor shifts another's draws */
} Sensors;

void sensors_start(Sensors *s, const uint64_t rng_seeds[4]);

/* Read what is due at the step `truth[WORLD_step]`: the inertial unit always, the others at their rates. */
void sensors_read(Sensors *s, const double truth[WORLD_SLOT_COUNT]);

#endif
