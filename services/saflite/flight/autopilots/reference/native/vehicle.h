/* The reference autopilot's blackboard: every number that estimator, control and the Python modes share.
 *
 * One struct per flight, with the world and the sensors in it, so that all three are stepped in one native loop
 * (vehicle.c). Its doubles are mapped into Python; the names come from the lists below and from those of world.h and
 * sensors.h, so the two sides cannot disagree. Frames: north-east-down and body forward-right-down in here; up-positive
 * only where the name says altitude or climb. SI units, radians unless named.
 */
#ifndef SAFLITE_VEHICLE_H
#define SAFLITE_VEHICLE_H

#include <stdint.h>

#include "recorder.h"
#include "sensors.h"
#include "world.h"

#define STEPS_PER_STATE STEPS_PER_BARO /* truth, height, corrections: 50 Hz */
#define STEPS_PER_OUTER 4              /* position and velocity loops: 100 Hz */

/* Written by the Python side for the trace. */
#define SLOTS_MODES(X) \
    X(mode) X(armed) X(landed) X(mission_item) X(altitude_target_m) X(altitude_source) X(home_distance_m) \
    X(circle_radius_m) X(mission_count) X(taken_off) X(takeoff) X(rc1_pwm) X(rc2_pwm) X(rc3_pwm) X(rc4_pwm) \
    X(rc_present) X(failsafe_gps) X(failsafe_radio) X(failsafe_battery) X(failsafe_fence) \
    X(rtl_altitude_set_m) X(rtl_altitude_final_set_m) X(land_speed_set_mps) X(land_speed_high_set_mps) \
    X(pilot_speed_up_set_mps) X(takeoff_altitude_set_m) X(takeoff_speed_set_mps) X(chute_altitude_min_set_m) \
    X(fs_throttle_set_pwm) X(fs_throttle_enabled) X(fs_gps_action) X(fs_gps_delay_set_s) X(fence_enabled) \
    X(fence_altitude_max_set_m) X(battery_low_set_v) X(circle_rate_dps) X(land_altitude_low_set_m) \
    X(home_north) X(home_east) X(home_up)

/* What the autopilot makes of its sensors, and how it is told to. */
#define SLOTS_RECEIVED(X) \
    X(baro_altitude_m) X(baro_ok) X(gps_altitude_m) X(gps_ok) X(battery_v) X(battery_a) \
    X(cal_acc_x) X(cal_acc_y) X(cal_acc_z) X(cal_gyr_x) X(cal_gyr_y) X(cal_gyr_z) X(cal_mag_x) X(cal_mag_y) X(cal_mag_z) \
    X(baro_ground_m) X(baro_alt_offset) X(baro_gain) X(gps_lever_x) X(gps_lever_y) X(gps_lever_z) X(gps_sats_min) \
    X(battery_amp_scale) X(battery_volt_scale)

/* The estimate and the estimator's settings. */
#define SLOTS_ESTIMATE(X) \
    X(est_n) X(est_e) X(est_d) X(est_vn) X(est_ve) X(est_vd) X(est_roll) X(est_pitch) X(est_yaw) \
    X(est_p) X(est_q) X(est_r) X(est_az) X(x_est_m) X(y_est_m) X(altitude_est_m) X(climb_est_mps) \
    X(position_ok) X(gps_age_s) X(baro_age_s) X(innovation_ratio) X(height_from) X(est_trim_x) X(est_trim_y) \
    X(est_gate_m) X(est_height_noise) X(est_position_noise) X(est_velocity_noise) X(est_yaw_noise) X(est_gyro_noise) \
    X(est_acc_noise) X(compass_use) X(height_source) \
    X(defect_height_gps) X(est_reset_n) X(est_reset_e)

/* Set-points: what the modes ask of the control loops. See control.c for the words of `want_*`. */
#define SLOTS_WANT(X) \
    X(want_xy) X(want_z) X(want_attitude) X(want_yaw) X(set_n) X(set_e) X(set_vn) X(set_ve) X(set_altitude) \
    X(set_climb) X(set_throttle) X(set_roll) X(set_pitch) X(set_yaw) X(set_p) X(set_q) X(set_r) \
    X(climb_max) X(descent_max) X(speed_max) X(motors_on) X(reset_loops) X(tilt_max)

/* What control does. */
#define SLOTS_CONTROL(X) \
    X(throttle) X(target_roll) X(target_pitch) X(target_yaw) X(target_vn) X(target_ve) X(target_climb) X(target_az) \
    X(out_roll) X(out_pitch) X(out_yaw) X(saturated) X(hover)

/* Settings of the loops: the parameters that act in C. */
#define SLOTS_SETTINGS(X) \
    X(k_rat_r_p) X(k_rat_r_i) X(k_rat_r_d) X(k_rat_r_ff) X(k_rat_r_imax) X(k_rat_r_fltt) X(k_rat_r_flte) X(k_rat_r_fltd) \
    X(k_rat_p_p) X(k_rat_p_i) X(k_rat_p_d) X(k_rat_p_ff) X(k_rat_p_imax) X(k_rat_p_fltt) X(k_rat_p_flte) X(k_rat_p_fltd) \
    X(k_rat_y_p) X(k_rat_y_i) X(k_rat_y_d) X(k_rat_y_ff) X(k_rat_y_imax) X(k_rat_y_fltt) X(k_rat_y_flte) X(k_rat_y_fltd) \
    X(k_ang_r_p) X(k_ang_p_p) X(k_ang_y_p) X(k_rate_r_max) X(k_rate_p_max) X(k_rate_y_max) X(k_acc_r_max) X(k_acc_p_max) \
    X(k_acc_y_max) X(k_slew_yaw) X(k_input_tc) X(k_pos_p) X(k_vel_p) X(k_vel_i) X(k_vel_d) X(k_vel_imax) X(k_vel_flte) \
    X(k_acc_xy) X(k_jerk_xy) X(k_posz_p) X(k_velz_p) X(k_accz_p) X(k_accz_i) X(k_accz_d) X(k_accz_imax) X(k_acc_z) \
    X(k_angle_boost) X(k_mix_min) X(k_mix_max) X(k_mix_man) X(k_spin_min) X(k_spin_max) X(k_expo) X(k_slew_up) \
    X(k_slew_dn) X(k_boost) X(k_gyro_filter) X(k_acc_filter) X(k_thr_filter)

#define SLOTS(X) SLOTS_MODES(X) SLOTS_RECEIVED(X) SLOTS_ESTIMATE(X) SLOTS_WANT(X) SLOTS_CONTROL(X) SLOTS_SETTINGS(X)

#define SLOT_ENUM(name) S_##name,
enum { SLOTS(SLOT_ENUM) SLOT_COUNT };
#undef SLOT_ENUM

enum { WANT_XY_NONE = 0, WANT_XY_VELOCITY = 1, WANT_XY_POSITION = 2 };
enum { WANT_Z_THROTTLE = 0, WANT_Z_CLIMB = 1, WANT_Z_ALTITUDE = 2 };
enum { WANT_ANGLES = 0, WANT_RATES = 1 };
enum { WANT_YAW_RATE = 0, WANT_YAW_ANGLE = 1 };

typedef struct { double sum, last_error, last_target, last_d; } Pid;

typedef struct {
    World world;
    Sensors sensors;
    double at[SLOT_COUNT];
    double quat[4];            /* estimate: body to north-east-down */
    double gyro_bias[3], acc_bias_d;
    double baro_offset;        /* BARO_ALT_OFFSET as it creeps in */
    double gps_rejected_s, gps_silent_s, baro_silent_s;
    double attitude_target[3]; /* roll, pitch, yaw after input shaping */
    double vel_sum[2], vel_filtered[2], vel_last[2], accel_out[2], accz_sum, accz_last, climb_set, throttle_filtered;
    double gyro_filtered[3], acc_z_filtered, motor[MOTORS];
    int leaning_full;          /* the lean asked for was cut to the greatest allowed */
    int plane_ran;             /* the speed loop ran in the step before */
    Pid roll, pitch, yaw;
    Recorder recorder;
} Vehicle;

#define AT(name) (v->at[S_##name])
#define TRUTH(name) (v->world.at[WORLD_##name])
#define READING(name) (v->sensors.at[SENSOR_##name])

static inline int64_t step_of(const Vehicle *v) { return (int64_t)TRUTH(step); }

void estimator_start(Vehicle *v);
void estimator_step(Vehicle *v);
void estimator_slow(Vehicle *v);
void control_start(Vehicle *v);
void control_step(Vehicle *v);

#endif
