/* State estimation: a strapdown inertial solution corrected by GPS, height sensor, compass and, without GPS, gravity.
 *
 * The gains are those of a Kalman filter in its steady state, so the estimate behaves like ArduPilot's EKF where it
 * matters to safety: offsets of the GPS pull the vehicle away, jumps are gated and after ten seconds believed, drift of
 * the barometer drags the altitude, and without GPS position and speed run on inertia alone.
 */
#include <math.h>

#include "vehicle.h"

static const double REJECTED_MAX_S = 10.0, GPS_STALE_S = 1.0;
static const double MAGNETIC_DECLINATION = 0.0602; /* atan2(0.0129, 0.2142) */

static void rotation_of(const double q[4], double r[9])
{
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    r[0] = 1 - 2 * (y * y + z * z), r[1] = 2 * (x * y - w * z), r[2] = 2 * (x * z + w * y);
    r[3] = 2 * (x * y + w * z), r[4] = 1 - 2 * (x * x + z * z), r[5] = 2 * (y * z - w * x);
    r[6] = 2 * (x * z - w * y), r[7] = 2 * (y * z + w * x), r[8] = 1 - 2 * (x * x + y * y);
}

static void unit(double q[4])
{
    double scale = 1.0 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++)
        q[i] *= scale;
}

/* Turn the estimate by the small rotation `turn` (radians, north-east-down axes). */
static void turn_world(double q[4], const double turn[3])
{
    const double a = 0.5 * turn[0], b = 0.5 * turn[1], c = 0.5 * turn[2];
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    q[0] = w - a * x - b * y - c * z;
    q[1] = x + a * w + b * z - c * y;
    q[2] = y - a * z + b * w + c * x;
    q[3] = z + a * y - b * x + c * w;
    unit(q);
}

/* Turn the estimate by the body rate `w` over `dt`. */
static void turn_body(double q[4], const double rate[3], double dt)
{
    const double a = 0.5 * dt * rate[0], b = 0.5 * dt * rate[1], c = 0.5 * dt * rate[2];
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    q[0] = w - a * x - b * y - c * z;
    q[1] = x + a * w + c * y - b * z;
    q[2] = y + b * w - c * x + a * z;
    q[3] = z + c * w + b * x - a * y;
    unit(q);
}

static void publish(Vehicle *v, const double r[9])
{
    AT(est_roll) = atan2(r[7], r[8]) + AT(est_trim_x);
    AT(est_pitch) = asin(clamp(-r[6], -1.0, 1.0)) + AT(est_trim_y);
    AT(est_yaw) = atan2(r[3], r[0]);
    AT(altitude_est_m) = -AT(est_d) - AT(home_up);
    AT(climb_est_mps) = -AT(est_vd);
    AT(x_est_m) = AT(est_n);
    AT(y_est_m) = AT(est_e);
}

void estimator_start(Vehicle *v)
{
    v->quat[0] = cos(0.5 * TRUTH(yaw_rad)), v->quat[1] = 0.0, v->quat[2] = 0.0, v->quat[3] = sin(0.5 * TRUTH(yaw_rad));
    AT(est_n) = TRUTH(x_m), AT(est_e) = TRUTH(y_m), AT(est_d) = -TRUTH(altitude_m);
    AT(est_vn) = TRUTH(vx_mps), AT(est_ve) = TRUTH(vy_mps), AT(est_vd) = -TRUTH(climb_mps);
    for (int i = 0; i < 3; i++)
        v->gyro_bias[i] = v->sensors.gyro_at_rest_rps[i];
    v->acc_bias_d = 0.0;
    v->gps_rejected_s = v->gps_silent_s = v->baro_silent_s = 0.0;
    AT(position_ok) = 1.0;
    AT(height_from) = AT(height_source);
    double r[9];
    rotation_of(v->quat, r);
    publish(v, r);
}

/* The accelerometers' readings, calibrated (INS_ACCOFFS_*). */
static void acceleration(const Vehicle *v, double acc[3])
{
    for (int i = 0; i < 3; i++)
        acc[i] = v->sensors.at[SENSOR_acc_x_mps2 + i] - v->at[S_cal_acc_x + i];
}

/* Inertial prediction at the physics rate. */
void estimator_step(Vehicle *v)
{
    double rate[3], r[9];
    for (int i = 0; i < 3; i++) {
        rate[i] = v->sensors.at[SENSOR_gyro_x_rps + i] - v->at[S_cal_gyr_x + i] - v->gyro_bias[i];
        v->at[S_est_p + i] = rate[i];
    }
    turn_body(v->quat, rate, STEP_S);
    rotation_of(v->quat, r);
    double acc[3];
    acceleration(v, acc);
    const double x = acc[0], y = acc[1], z = acc[2];
    const double an = r[0] * x + r[1] * y + r[2] * z, ae = r[3] * x + r[4] * y + r[5] * z;
    const double ad = r[6] * x + r[7] * y + r[8] * z + GRAVITY - v->acc_bias_d;
    if (AT(position_ok) != 0.0) {
        AT(est_n) += AT(est_vn) * STEP_S, AT(est_e) += AT(est_ve) * STEP_S;
        AT(est_vn) += an * STEP_S, AT(est_ve) += ae * STEP_S;
    }
    AT(est_d) += AT(est_vd) * STEP_S;
    AT(est_vd) += ad * STEP_S;
    AT(est_az) = -ad;
    publish(v, r);
}

/* Without GPS: let gravity, as far as the accelerometer shows it, level the attitude. Weakly: a multirotor's
 * accelerometer reads thrust along its own axis however it leans, so the gyros know better for minutes. */
static void level_by_gravity(Vehicle *v)
{
    double r[9], acc[3];
    rotation_of(v->quat, r);
    acceleration(v, acc);
    const double x = acc[0], y = acc[1], z = acc[2], size = sqrt(x * x + y * y + z * z);
    if (size < 0.7 * GRAVITY || size > 1.3 * GRAVITY)
        return;
    const double un = (r[0] * x + r[1] * y + r[2] * z) / size, ue = (r[3] * x + r[4] * y + r[5] * z) / size;
    const double gain = 0.003 * (0.35 / AT(est_acc_noise));
    const double turn[3] = {-gain * ue, gain * un, 0.0}; /* measured up is (un, ue, .), it should be (0, 0, -1) */
    turn_world(v->quat, turn);
}

/* Tilt follows from the speed error: a wrong tilt accelerates the estimate by g times the error. */
static void correct_tilt(Vehicle *v, double dvn, double dve)
{
    const double gain = 0.04 / GRAVITY;
    const double turn[3] = {clamp(gain * dve, -0.02, 0.02), clamp(-gain * dvn, -0.02, 0.02), 0.0};
    double r[9];
    turn_world(v->quat, turn);
    rotation_of(v->quat, r);
    for (int i = 0; i < 3; i++)
        v->gyro_bias[i] = clamp(v->gyro_bias[i] - 0.02 * (r[i] * turn[0] + r[3 + i] * turn[1]), -0.1, 0.1);
}

/* The antenna does not sit in the centre of gravity: take its lever arm out, as the parameters give it. */
static void antenna(const Vehicle *v, double lever[3])
{
    double r[9];
    rotation_of(v->quat, r);
    for (int i = 0; i < 3; i++)
        lever[i] = r[3 * i] * AT(gps_lever_x) + r[3 * i + 1] * AT(gps_lever_y) + r[3 * i + 2] * AT(gps_lever_z);
}

static void fuse_gps(Vehicle *v)
{
    const double every_s = STEPS_PER_GPS * STEP_S;
    if (AT(gps_ok) == 0.0 || READING(gps_satellites) < 4.0) {
        v->gps_silent_s += every_s;
        return;
    }
    double lever[3];
    antenna(v, lever);
    const double dn = READING(gps_north_m) - lever[0] - AT(est_n), de = READING(gps_east_m) - lever[1] - AT(est_e);
    const double dvn = READING(gps_vn_mps) - AT(est_vn), dve = READING(gps_ve_mps) - AT(est_ve);
    const double ratio = sqrt(dn * dn + de * de) / AT(est_gate_m);
    AT(innovation_ratio) += 0.3 * (ratio - AT(innovation_ratio));
    if (AT(position_ok) == 0.0 || (ratio > 1.0 && v->gps_rejected_s >= REJECTED_MAX_S)) {
        AT(est_reset_n) += dn, AT(est_reset_e) += de;
        AT(est_n) += dn, AT(est_e) += de, AT(est_vn) += dvn, AT(est_ve) += dve;
        AT(innovation_ratio) = v->gps_rejected_s = v->gps_silent_s = 0.0;
        return;
    }
    if (ratio > 1.0) {
        v->gps_rejected_s += every_s;
        v->gps_silent_s += every_s;
        return;
    }
    v->gps_rejected_s = v->gps_silent_s = 0.0;
    AT(est_n) += 0.12 * dn / AT(est_position_noise), AT(est_e) += 0.12 * de / AT(est_position_noise);
    AT(est_vn) += 0.25 * dvn / AT(est_velocity_noise) + 0.02 * dn;
    AT(est_ve) += 0.25 * dve / AT(est_velocity_noise) + 0.02 * de;
    correct_tilt(v, dvn, dve);
}

static void fuse_compass(Vehicle *v)
{
    if (AT(compass_use) == 0.0)
        return;
    const double cr = cos(AT(est_roll)), sr = sin(AT(est_roll)), cp = cos(AT(est_pitch)), sp = sin(AT(est_pitch));
    double mag[3];
    for (int i = 0; i < 3; i++)
        mag[i] = v->sensors.at[SENSOR_compass_x_gauss + i] + v->at[S_cal_mag_x + i];
    const double x = cp * mag[0] + sr * sp * mag[1] + cr * sp * mag[2];
    const double y = cr * mag[1] - sr * mag[2];
    double error = atan2(-y, x) + MAGNETIC_DECLINATION - AT(est_yaw);
    error -= 2.0 * PI * floor((error + PI) / (2.0 * PI));
    const double gain = 0.05 * (0.5 / AT(est_yaw_noise));
    const double turn[3] = {0.0, 0.0, clamp(gain * error, -0.05, 0.05)};
    turn_world(v->quat, turn);
    double r[9];
    rotation_of(v->quat, r);
    for (int i = 0; i < 3; i++)
        v->gyro_bias[i] = clamp(v->gyro_bias[i] - 0.02 * r[6 + i] * turn[2], -0.1, 0.1);
}

/* Height above the origin as the chosen source gives it; false where the source is silent. */
static int height_reading(Vehicle *v, double *up_m)
{
    const int source = (int)AT(height_source);
    double lever[3] = {0, 0, 0};
    antenna(v, lever);
    AT(height_from) = source;
    if (AT(defect_height_gps) != 0.0 && READING(gps_satellites) >= 4.0) /* planted: says one source, uses another */
        return *up_m = READING(gps_up_m) + lever[2], 1;
    if (source == 2 && READING(gps_satellites) >= 4.0)
        return *up_m = READING(gps_up_m) + lever[2], 1;
    if (source == 1 && READING(rangefinder_m) < 39.0)
        return *up_m = READING(rangefinder_m) * cos(AT(est_roll)) * cos(AT(est_pitch)), 1;
    AT(height_from) = 0.0;
    if (AT(baro_ok) == 0.0)
        return 0;
    return *up_m = AT(baro_altitude_m) + AT(baro_ground_m), 1;
}

static void fuse_height(Vehicle *v)
{
    const double dt = STEPS_PER_STATE * STEP_S;
    double up_m = 0.0;
    if (!height_reading(v, &up_m)) {
        v->baro_silent_s += dt;
        if (READING(gps_satellites) < 4.0)
            return;
        up_m = READING(gps_up_m); /* the last resort, as ArduPilot does */
        AT(height_from) = 2.0;
    } else {
        v->baro_silent_s = 0.0;
    }
    const double error = up_m + AT(est_d); /* positive: we are higher than believed */
    const double pole = clamp(1.0 * sqrt(3.0 / AT(est_height_noise)), 0.3, 3.0);
    const double limited = clamp(error, -10.0, 10.0);
    AT(est_d) -= 3.0 * pole * error * dt;
    AT(est_vd) -= 3.0 * pole * pole * limited * dt;
    v->acc_bias_d = clamp(v->acc_bias_d + 0.3 * pole * pole * pole * limited * dt, -1.0, 1.0);
}

/* Corrections at the sensors' rates: height 50 Hz, GPS and compass 10 Hz. */
void estimator_slow(Vehicle *v)
{
    fuse_height(v);
    if (step_of(v) % STEPS_PER_GPS != 0)
        return;
    fuse_gps(v);
    fuse_compass(v);
    AT(gps_age_s) = v->gps_silent_s;
    AT(baro_age_s) = v->baro_silent_s;
    AT(position_ok) = v->gps_silent_s <= (v->gps_rejected_s > 0.0 ? REJECTED_MAX_S + 1.0 : GPS_STALE_S) ? 1.0 : 0.0;
    if (v->gps_silent_s > 0.0)
        level_by_gravity(v);
    if (AT(position_ok) == 0.0)
        AT(est_vn) = AT(est_ve) = 0.0;
}
