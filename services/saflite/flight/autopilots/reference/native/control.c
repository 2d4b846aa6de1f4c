/* The control cascade: position, speed and height at 100 Hz, attitude, rates and mixer at the physics rate.
 *
 * Structure and names of the settings follow ArduCopter's AC_PosControl, AC_AttitudeControl and AP_MotorsMatrix. What a
 * mode wants is said in the `want_*` slots: speed or position in the plane, throttle, climb or altitude, angles or
 * rates, yaw rate or yaw angle.
 */
#include <math.h>
#include <string.h>

#include "vehicle.h"

static const double OUTER_S = STEPS_PER_OUTER * STEP_S;
static const double SOFTEST_S = 0.25;    /* a speed loop over an attitude that follows more softly swings (AC_PosControl lowers its jerk) */
static const double BRAKING_SHARE = 0.6; /* of what the greatest lean gives: the lean follows late, the rest makes good */

/* Share of the way a first-order low pass goes in one step; 0 Hz means no filter. */
static double share(double cut_hz, double dt)
{
    if (cut_hz <= 0.0)
        return 1.0;
    const double x = 2.0 * PI * cut_hz * dt;
    return x / (1.0 + x);
}

static double wrap(double angle)
{
    return angle - 2.0 * PI * floor((angle + PI) / (2.0 * PI));
}

/* The speed loop begins at the speed at hand, not at what it aimed at when it last ran (AC_PosControl::init_xy_controller). */
static void reset_plane(Vehicle *v)
{
    for (int i = 0; i < 2; i++) {
        v->vel_sum[i] = v->vel_filtered[i] = v->vel_last[i] = v->accel_out[i] = 0.0;
        v->at[S_target_vn + i] = v->at[S_est_vn + i];
    }
    v->leaning_full = 0;
}

static void reset_outer(Vehicle *v)
{
    reset_plane(v);
    v->accz_sum = 0.0;
    v->climb_set = AT(climb_est_mps);
    AT(reset_loops) = 0.0;
}

void control_start(Vehicle *v)
{
    reset_outer(v);
    memset(&v->roll, 0, sizeof v->roll);
    memset(&v->pitch, 0, sizeof v->pitch);
    memset(&v->yaw, 0, sizeof v->yaw);
    memset(v->motor, 0, sizeof v->motor);
    memset(v->gyro_filtered, 0, sizeof v->gyro_filtered);
    v->attitude_target[0] = v->attitude_target[1] = 0.0;
    v->attitude_target[2] = AT(est_yaw);
    v->throttle_filtered = 0.0;
}

/* Speed wanted in the plane: from the position error (slowing down in time to stop) or as asked. */
static void wanted_speed(const Vehicle *v, double want[2])
{
    want[0] = AT(set_vn), want[1] = AT(set_ve);
    if (AT(want_xy) == WANT_XY_POSITION) {
        const double dn = AT(set_n) - AT(est_n), de = AT(set_e) - AT(est_e), gap = sqrt(dn * dn + de * de);
        const double most = BRAKING_SHARE * GRAVITY * tan(AT(tilt_max)), p = AT(k_pos_p);
        const double braking = AT(k_acc_xy) < most ? AT(k_acc_xy) : most, knee = braking / (p * p);
        double speed = gap > knee ? sqrt(2.0 * braking * (gap - 0.5 * knee)) : gap * p;
        speed = speed > AT(speed_max) ? AT(speed_max) : speed;
        if (gap > 1e-6)
            want[0] += speed * dn / gap, want[1] += speed * de / gap;
    }
}

/* Speed loop: tilt from the wanted acceleration.
 *
 * PSC_JERK_XY shapes what is asked. Slower than the loop takes back the acceleration it asked for itself it would make
 * the vehicle swing wider and wider, so it does not go below that (AC_PosControl leaves the feedback unshaped). */
static void plane_loop(Vehicle *v)
{
    double want[2], accel[2];
    wanted_speed(v, want);
    const double tan_max = tan(AT(tilt_max)), limit = GRAVITY * tan_max;
    for (int i = 0; i < 2; i++) {
        double *target = &v->at[S_target_vn + i];
        *target += clamp(want[i] - *target, -AT(k_acc_xy) * OUTER_S, AT(k_acc_xy) * OUTER_S);
        const double error = *target - v->at[S_est_vn + i];
        v->vel_filtered[i] += share(AT(k_vel_flte), OUTER_S) * (error - v->vel_filtered[i]);
        if (!v->leaning_full || v->accel_out[i] * error < 0.0) /* what is cut off is not summed up (AC_PID_2D) */
            v->vel_sum[i] = clamp(v->vel_sum[i] + AT(k_vel_i) * error * OUTER_S, -AT(k_vel_imax), AT(k_vel_imax));
        const double slope = (v->vel_filtered[i] - v->vel_last[i]) / OUTER_S;
        v->vel_last[i] = v->vel_filtered[i];
        accel[i] = AT(k_vel_p) * v->vel_filtered[i] + v->vel_sum[i] + AT(k_vel_d) * slope;
        const double jerk = fmax(AT(k_jerk_xy), AT(k_vel_p) * AT(k_acc_xy)) * OUTER_S;
        v->accel_out[i] += clamp(accel[i] - v->accel_out[i], -jerk, jerk);
    }
    const double size = sqrt(v->accel_out[0] * v->accel_out[0] + v->accel_out[1] * v->accel_out[1]);
    v->leaning_full = size > limit;
    if (v->leaning_full)
        v->accel_out[0] *= limit / size, v->accel_out[1] *= limit / size;
    const double cy = cos(AT(est_yaw)), sy = sin(AT(est_yaw));
    const double forward = cy * v->accel_out[0] + sy * v->accel_out[1];
    const double right = -sy * v->accel_out[0] + cy * v->accel_out[1];
    AT(set_pitch) = atan(-forward / GRAVITY);
    AT(set_roll) = atan(right * cos(AT(set_pitch)) / GRAVITY);
}

/* Height: altitude to climb rate to acceleration to throttle. */
static void height_loop(Vehicle *v)
{
    double climb = AT(set_climb);
    if (AT(want_z) == WANT_Z_ALTITUDE) {
        const double error = AT(set_altitude) - AT(altitude_est_m), p = AT(k_posz_p), knee = AT(k_acc_z) / (p * p);
        const double gap = fabs(error);
        const double speed = gap > knee ? sqrt(2.0 * AT(k_acc_z) * (gap - 0.5 * knee)) : gap * p;
        climb += error > 0.0 ? speed : -speed;
        climb = clamp(climb, -AT(descent_max), AT(climb_max));
    }
    v->climb_set += clamp(climb - v->climb_set, -AT(k_acc_z) * OUTER_S, AT(k_acc_z) * OUTER_S);
    AT(target_climb) = v->climb_set;
    const double az = clamp(AT(k_velz_p) * (v->climb_set - AT(climb_est_mps)), -6.0, 6.0);
    AT(target_az) = az;
    v->acc_z_filtered += share(AT(k_acc_filter), OUTER_S) * (AT(est_az) - v->acc_z_filtered);
    const double error = az - v->acc_z_filtered, slope = (error - v->accz_last) / OUTER_S;
    v->accz_last = error;
    const double imax = AT(k_accz_imax);
    if (AT(saturated) == 0.0 || v->accz_sum * error < 0.0)
        v->accz_sum = clamp(v->accz_sum + AT(k_accz_i) * error * OUTER_S, -imax, imax);
    AT(set_throttle) = clamp(AT(hover) + AT(k_accz_p) * error + v->accz_sum + AT(k_accz_d) * slope, 0.0, 1.0);
}

/* Learn the hover throttle in quiet level flight (MOT_HOVER_LEARN). */
static void learn_hover(Vehicle *v)
{
    if (AT(motors_on) > 1.0 && fabs(AT(climb_est_mps)) < 0.6 && fabs(AT(est_roll)) + fabs(AT(est_pitch)) < 0.15)
        AT(hover) = clamp(AT(hover) + OUTER_S / 10.0 * (v->throttle_filtered - AT(hover)), 0.125, 0.6875);
}

/* Bring roll or pitch towards what is asked, with the time constant and the greatest rate set. */
static double shape(const Vehicle *v, double now, double want, double rate_max)
{
    const double limit = (rate_max > 0.0 ? rate_max : 12.0) * STEP_S;
    const double constant_s = AT(want_xy) != WANT_XY_NONE ? fmin(AT(k_input_tc), SOFTEST_S) : AT(k_input_tc);
    return now + clamp((want - now) * STEP_S / constant_s, -limit, limit);
}

/* Keep a yaw rate within ATC_RATE_Y_MAX, if that is set. */
static double within_rate(const Vehicle *v, double rate)
{
    return AT(k_rate_y_max) > 0.0 ? clamp(rate, -AT(k_rate_y_max), AT(k_rate_y_max)) : rate;
}

static double shape_yaw(const Vehicle *v, double now)
{
    double next = now;
    if (AT(want_yaw) == WANT_YAW_ANGLE) {
        const double limit = within_rate(v, AT(k_slew_yaw)) * STEP_S;
        next += clamp(wrap(AT(set_yaw) - now), -limit, limit);
    } else
        next += within_rate(v, AT(set_r)) * STEP_S;
    return AT(est_yaw) + clamp(wrap(next - AT(est_yaw)), -0.6, 0.6);
}

/* Attitude error as a rotation in body axes: from the estimate to the target quaternion. */
static void attitude_error(const Vehicle *v, double error[3])
{
    const double roll = 0.5 * (v->attitude_target[0] - AT(est_trim_x)), yaw = 0.5 * v->attitude_target[2];
    const double pitch = 0.5 * (v->attitude_target[1] - AT(est_trim_y));
    const double cr = cos(roll), sr = sin(roll), cp = cos(pitch), sp = sin(pitch), cy = cos(yaw), sy = sin(yaw);
    const double t[4] = {cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy,
                         cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy};
    const double *q = v->quat;
    const double w = q[0] * t[0] + q[1] * t[1] + q[2] * t[2] + q[3] * t[3], sign = w < 0.0 ? -2.0 : 2.0;
    error[0] = sign * (q[0] * t[1] - q[1] * t[0] - q[2] * t[3] + q[3] * t[2]);
    error[1] = sign * (q[0] * t[2] + q[1] * t[3] - q[2] * t[0] - q[3] * t[1]);
    error[2] = sign * (q[0] * t[3] - q[1] * t[2] + q[2] * t[1] - q[3] * t[0]);
}

/* Rate that turns an angle error away: proportional near it, square root far off (bounded acceleration). */
static double rate_for(double error, double p, double acc_max, double rate_max)
{
    double rate = error * p;
    if (acc_max > 0.0 && p > 0.0) {
        const double knee = acc_max / (p * p), size = fabs(error);
        if (size > knee)
            rate = copysign(sqrt(2.0 * acc_max * (size - 0.5 * knee)), error);
    }
    return rate_max > 0.0 ? clamp(rate, -rate_max, rate_max) : rate;
}

static void attitude_loop(Vehicle *v, double rate[3])
{
    double error[3];
    const double before[2] = {v->attitude_target[0], v->attitude_target[1]};
    v->attitude_target[0] = shape(v, before[0], AT(set_roll), AT(k_rate_r_max));
    v->attitude_target[1] = shape(v, before[1], AT(set_pitch), AT(k_rate_p_max));
    v->attitude_target[2] = shape_yaw(v, v->attitude_target[2]);
    attitude_error(v, error);
    rate[0] = rate_for(error[0], AT(k_ang_r_p), AT(k_acc_r_max), AT(k_rate_r_max));
    rate[1] = rate_for(error[1], AT(k_ang_p_p), AT(k_acc_p_max), AT(k_rate_p_max));
    rate[2] = rate_for(error[2], AT(k_ang_y_p), AT(k_acc_y_max), AT(k_rate_y_max));
    rate[0] += (v->attitude_target[0] - before[0]) / STEP_S;
    rate[1] += (v->attitude_target[1] - before[1]) / STEP_S;
    rate[2] += AT(want_yaw) == WANT_YAW_RATE ? within_rate(v, AT(set_r)) : 0.0;
}

static void rates_asked(Vehicle *v, double rate[3])
{
    rate[0] = AT(set_p), rate[1] = AT(set_q), rate[2] = AT(set_r);
    v->attitude_target[0] = AT(est_roll), v->attitude_target[1] = AT(est_pitch), v->attitude_target[2] = AT(est_yaw);
}

/* Settings of one axis lie in order: P, I, D, FF, IMAX, FLTT, FLTE, FLTD. */
static double pid(Pid *pid, const double *k, double target, double measured, int frozen)
{
    pid->last_target += share(k[5], STEP_S) * (target - pid->last_target);
    const double raw = pid->last_target - measured;
    const double error = pid->last_error + share(k[6], STEP_S) * (raw - pid->last_error);
    const double slope = (error - pid->last_error) / STEP_S;
    pid->last_d += share(k[7], STEP_S) * (slope - pid->last_d);
    pid->last_error = error;
    if (!frozen || pid->sum * error < 0.0)
        pid->sum = clamp(pid->sum + k[1] * error * STEP_S, -k[4], k[4]);
    return k[0] * error + pid->sum + k[2] * pid->last_d + k[3] * pid->last_target;
}

static void rate_loop(Vehicle *v, const double rate[3])
{
    const double a = share(AT(k_gyro_filter), STEP_S);
    const int frozen = AT(saturated) != 0.0 || AT(motors_on) < 2.0;
    for (int i = 0; i < 3; i++)
        v->gyro_filtered[i] += a * (v->at[S_est_p + i] - v->gyro_filtered[i]);
    AT(out_roll) = clamp(pid(&v->roll, &AT(k_rat_r_p), rate[0], v->gyro_filtered[0], frozen), -1.0, 1.0);
    AT(out_pitch) = clamp(pid(&v->pitch, &AT(k_rat_p_p), rate[1], v->gyro_filtered[1], frozen), -1.0, 1.0);
    AT(out_yaw) = clamp(pid(&v->yaw, &AT(k_rat_y_p), rate[2], v->gyro_filtered[2], frozen), -1.0, 1.0);
}

/* Actuator for a thrust share (MOT_THST_EXPO), between the spin limits, with the slew limits. */
static double actuator(const Vehicle *v, double thrust, double before)
{
    const double e = AT(k_expo), t = clamp(thrust, 0.0, 1.0);
    const double bent = e > 0.01 ? ((e - 1.0) + sqrt((1.0 - e) * (1.0 - e) + 4.0 * e * t)) / (2.0 * e) : t;
    double out = AT(k_spin_min) + (AT(k_spin_max) - AT(k_spin_min)) * bent;
    if (AT(k_slew_up) > 0.0 && out > before + STEP_S / AT(k_slew_up))
        out = before + STEP_S / AT(k_slew_up);
    if (AT(k_slew_dn) > 0.0 && out < before - STEP_S / AT(k_slew_dn))
        out = before - STEP_S / AT(k_slew_dn);
    return clamp(out, 0.0, 1.0);
}

/* Quad X in ArduPilot's order: front right, rear left, front left, rear right. Roll and pitch go before throttle, yaw last. */
static void mix(Vehicle *v, double throttle)
{
    static const double R[4] = {-0.5, 0.5, 0.5, -0.5}, P[4] = {0.5, -0.5, 0.5, -0.5}, Y[4] = {0.5, 0.5, -0.5, -0.5};
    double part[4], low = 0.0, high = 0.0;
    for (int i = 0; i < 4; i++) {
        part[i] = R[i] * AT(out_roll) + P[i] * AT(out_pitch);
        low = part[i] < low ? part[i] : low;
        high = part[i] > high ? part[i] : high;
    }
    const double mix_now = throttle > 0.6 * AT(hover) ? AT(k_mix_max) : AT(k_mix_man);
    const double reach = fmax(AT(k_mix_min), mix_now) * AT(hover); /* how far throttle may give way upwards */
    double base = clamp(throttle, 0.0, 1.0);
    base = base < -low ? fmin(-low, fmax(base, reach)) : base;
    base = base > 1.0 - high ? fmax(1.0 - high, 0.0) : base;
    const double room = fmax(0.1, fmin(base + low, 1.0 - base - high));
    const double yaw = clamp(AT(out_yaw), -2.0 * room, 2.0 * room);
    AT(saturated) = base != throttle || yaw != AT(out_yaw) ? 1.0 : 0.0;
    for (int i = 0; i < 4; i++)
        v->motor[i] = actuator(v, base + part[i] + Y[i] * yaw, v->motor[i]);
}

static void outputs(Vehicle *v)
{
    double throttle = AT(set_throttle);
    if (AT(want_attitude) == WANT_ANGLES && AT(k_angle_boost) != 0.0 && AT(want_z) != WANT_Z_THROTTLE) {
        const double level = cos(AT(est_roll)) * cos(AT(est_pitch));
        throttle /= level > 0.5 ? level : 0.5;
    }
    v->throttle_filtered += share(AT(k_thr_filter), STEP_S) * (throttle - v->throttle_filtered);
    AT(throttle) = AT(motors_on) < 2.0 ? 0.0 : clamp(throttle, 0.0, 1.0);
    if (AT(motors_on) > 1.0)
        mix(v, throttle);
    else
        for (int i = 0; i < 4; i++)
            v->motor[i] = AT(motors_on) > 0.0 ? 0.06 : 0.0;
}

void control_step(Vehicle *v)
{
    double rate[3];
    if (step_of(v) % STEPS_PER_OUTER == 0) {
        if (AT(reset_loops) != 0.0)
            reset_outer(v);
        if (AT(want_xy) != WANT_XY_NONE) {
            if (!v->plane_ran)
                reset_plane(v);
            plane_loop(v);
        }
        v->plane_ran = AT(want_xy) != WANT_XY_NONE;
        if (AT(want_z) != WANT_Z_THROTTLE) {
            height_loop(v);
            learn_hover(v);
        }
    }
    if (AT(want_attitude) == WANT_ANGLES)
        attitude_loop(v, rate);
    else
        rates_asked(v, rate);
    rate_loop(v, rate);
    outputs(v);
}
