"""Parameters of the control loops, the motors and the estimator.

Ranges of gains are those within which this airframe (F450, 45 ms motor lag) holds a hover and flies a mission; they lie
inside ArduCopter's documented ranges.
"""

from __future__ import annotations

from saflite.flight.autopilots.reference.parameter import Parameter as Row

CENTIDEGREE = 3.14159265358979 / 18000.0
DEGREE = CENTIDEGREE * 100.0


def _axis(name: str, letter: str, gains: tuple[float, ...], ranges: tuple[tuple[float, float], ...]) -> tuple[Row, ...]:
    parts = ("P", "I", "D", "FF", "IMAX", "FLTT", "FLTE", "FLTD")
    words = ("proportional gain", "integral gain", "derivative gain", "feed forward", "greatest integral")
    meanings = (*words, "target filter", "error filter, 0 off", "derivative filter")
    units = ("", "", "", "", "", "Hz", "Hz", "Hz")
    return tuple(
        Row(
            f"ATC_RAT_{name}_{part}",
            gain,
            low,
            high,
            unit,
            f"{name} rate loop: {meaning}",
            f"k_rat_{letter}_{part.lower()}",
        )
        for part, gain, (low, high), unit, meaning in zip(parts, gains, ranges, units, meanings, strict=True)
    )


_TILT_RANGES = (
    (0.05, 0.15),
    (0.01, 0.3),
    (0.0, 0.008),
    (0.0, 0.02),
    (0.0, 1.0),
    (10.0, 100.0),
    (0.0, 100.0),
    (10.0, 100.0),
)
_YAW_RANGES = ((0.1, 0.5), (0.01, 0.1), (0.0, 0.02), (0.0, 0.05), (0.0, 1.0), (5.0, 50.0), (0.0, 20.0), (5.0, 50.0))
_TILT = (0.09, 0.09, 0.0045, 0.0, 0.5, 20.0, 0.0, 20.0)

ROWS: tuple[Row, ...] = (
    *_axis("RLL", "r", _TILT, _TILT_RANGES),
    *_axis("PIT", "p", _TILT, _TILT_RANGES),
    *_axis("YAW", "y", (0.3, 0.03, 0.0, 0.0, 0.5, 20.0, 2.5, 20.0), _YAW_RANGES),
    Row("ATC_ANG_RLL_P", 4.5, 3, 8, "1/s", "roll angle loop gain", "k_ang_r_p"),
    Row("ATC_ANG_PIT_P", 4.5, 3, 8, "1/s", "pitch angle loop gain", "k_ang_p_p"),
    Row("ATC_ANG_YAW_P", 3.5, 2, 6, "1/s", "yaw angle loop gain", "k_ang_y_p"),
    Row(
        "ATC_RATE_R_MAX",
        0,
        0,
        1080,
        "deg/s",
        "greatest roll rate asked, 0 no limit; below 60 counts as 60",
        "k_rate_r_max",
        DEGREE,
    ),
    Row(
        "ATC_RATE_P_MAX",
        0,
        0,
        1080,
        "deg/s",
        "greatest pitch rate asked, 0 no limit; below 60 counts as 60",
        "k_rate_p_max",
        DEGREE,
    ),
    Row(
        "ATC_RATE_Y_MAX",
        0,
        0,
        1080,
        "deg/s",
        "greatest yaw rate asked, 0 no limit; below 20 counts as 20",
        "k_rate_y_max",
        DEGREE,
    ),
    Row(
        "ATC_ACCEL_R_MAX",
        110000,
        0,
        180000,
        "cdeg/s/s",
        "greatest roll acceleration asked, 0 no limit",
        "k_acc_r_max",
        CENTIDEGREE,
    ),
    Row(
        "ATC_ACCEL_P_MAX",
        110000,
        0,
        180000,
        "cdeg/s/s",
        "greatest pitch acceleration asked, 0 no limit",
        "k_acc_p_max",
        CENTIDEGREE,
    ),
    Row(
        "ATC_ACCEL_Y_MAX",
        27000,
        0,
        72000,
        "cdeg/s/s",
        "greatest yaw acceleration asked, 0 no limit",
        "k_acc_y_max",
        CENTIDEGREE,
    ),
    Row("ATC_SLEW_YAW", 4500, 500, 18000, "cdeg/s", "turning speed in autonomous modes", "k_slew_yaw", CENTIDEGREE),
    Row("ATC_INPUT_TC", 0.15, 0.05, 0.5, "s", "time constant of the attitude target", "k_input_tc"),
    Row("ATC_ANGLE_BOOST", 1, 0, 1, "", "raise throttle with tilt", "k_angle_boost"),
    Row("ATC_THR_MIX_MIN", 0.1, 0.1, 0.25, "", "throttle against attitude, low throttle", "k_mix_min"),
    Row("ATC_THR_MIX_MAX", 0.5, 0.5, 0.9, "", "throttle against attitude, active flight", "k_mix_max"),
    Row("ATC_THR_MIX_MAN", 0.1, 0.1, 0.9, "", "throttle against attitude, manual flight", "k_mix_man"),
    Row("PSC_POSXY_P", 1.0, 0.5, 2, "1/s", "position to speed", "k_pos_p"),
    Row("PSC_VELXY_P", 2.0, 1.0, 4, "1/s", "speed to acceleration", "k_vel_p"),
    Row("PSC_VELXY_I", 0.6, 0.02, 1.2, "1/s/s", "integral of the speed loop", "k_vel_i"),
    Row("PSC_VELXY_D", 0.1, 0, 0.3, "", "derivative of the speed loop", "k_vel_d"),
    Row("PSC_VELXY_IMAX", 500, 100, 1000, "cm/s/s", "greatest integral of the speed loop", "k_vel_imax", 0.01),
    Row("PSC_VELXY_FLTE", 5, 2, 20, "Hz", "filter of the speed error", "k_vel_flte"),
    Row("PSC_JERK_XY", 8, 3, 20, "m/s/s/s", "how fast the acceleration asked may change", "k_jerk_xy"),
    Row("WPNAV_ACCEL", 300, 100, 500, "cm/s/s", "acceleration in the plane", "k_acc_xy", 0.01),
    Row("WPNAV_ACCEL_Z", 200, 50, 500, "cm/s/s", "vertical acceleration", "k_acc_z", 0.01),
    Row("PSC_POSZ_P", 1.0, 0.8, 2, "1/s", "altitude to climb rate", "k_posz_p"),
    Row("PSC_VELZ_P", 4.0, 2, 6, "1/s", "climb rate to acceleration", "k_velz_p"),
    Row("PSC_ACCZ_P", 0.3, 0.2, 0.6, "", "acceleration to throttle (d% per cm/s/s)", "k_accz_p", 0.1),
    Row("PSC_ACCZ_I", 0.8, 0.2, 1.5, "", "integral of the acceleration loop", "k_accz_i", 0.1),
    Row("PSC_ACCZ_D", 0, 0, 0.02, "", "derivative of the acceleration loop", "k_accz_d", 0.1),
    Row("PSC_ACCZ_IMAX", 800, 300, 1000, "d%", "greatest integral of the acceleration loop", "k_accz_imax", 0.001),
    Row("MOT_SPIN_MIN", 0.1, 0, 0.2, "", "least motor output in flight", "k_spin_min", reboot=True),
    Row("MOT_SPIN_MAX", 0.95, 0.9, 1, "", "greatest motor output", "k_spin_max", reboot=True),
    Row("MOT_THST_EXPO", 0.65, 0.25, 0.8, "", "bend of the thrust curve", "k_expo", reboot=True),
    Row("MOT_THST_HOVER", 0.22, 0.15, 0.4, "", "throttle that hovers, learned in flight", "hover", reboot=True),
    Row("MOT_SLEW_UP_TIME", 0, 0, 0.2, "s", "time from no to full output", "k_slew_up"),
    Row("MOT_SLEW_DN_TIME", 0, 0, 0.2, "s", "time from full to no output", "k_slew_dn"),
    Row("INS_GYRO_FILTER", 50, 30, 200, "Hz", "filter of the gyros", "k_gyro_filter"),
    Row("INS_ACCEL_FILTER", 15, 8, 50, "Hz", "filter of the accelerometers in the height loop", "k_acc_filter"),
    Row(
        "EK2_ALT_SOURCE", 0, 0, 2, "", "height source: 0 barometer, 1 range finder, 2 GPS", "height_source", reboot=True
    ),
    Row("EK2_ALT_M_NSE", 3, 0.1, 10, "m", "noise of the height source as the filter takes it", "est_height_noise"),
    Row("EK2_POSNE_M_NSE", 1, 0.5, 10, "m", "noise of GPS positions as the filter takes it", "est_position_noise"),
    Row(
        "EK2_VELNE_M_NSE", 0.5, 0.25, 5, "m/s", "noise of GPS speeds as the filter takes it", "est_velocity_noise", 2.0
    ),
    Row("EK2_YAW_M_NSE", 0.5, 0.05, 1, "rad", "noise of the compass as the filter takes it", "est_yaw_noise"),
    Row("EK2_ACC_P_NSE", 0.35, 0.1, 1, "m/s/s", "noise of the accelerometers as the filter takes it", "est_acc_noise"),
    Row("EK2_POS_I_GATE", 500, 200, 1000, "", "size of the GPS gate in hundredths of its noise", "est_gate_m", 0.01),
    Row("COMPASS_USE", 1, 0, 1, "", "use the compass", "compass_use"),
    Row("AHRS_TRIM_X", 0, -0.1745, 0.1745, "rad", "roll offset of the board", "est_trim_x"),
    Row("AHRS_TRIM_Y", 0, -0.1745, 0.1745, "rad", "pitch offset of the board", "est_trim_y"),
    Row("INS_ACCOFFS_X", 0, -0.5, 0.5, "m/s/s", "accelerometer offset, forward", "cal_acc_x", reboot=True),
    Row("INS_ACCOFFS_Y", 0, -0.5, 0.5, "m/s/s", "accelerometer offset, right", "cal_acc_y", reboot=True),
    Row("INS_ACCOFFS_Z", 0, -1, 1, "m/s/s", "accelerometer offset, down", "cal_acc_z", reboot=True),
    Row("INS_GYROFFS_X", 0, -0.03, 0.03, "rad/s", "gyro offset, roll", "cal_gyr_x", reboot=True),
    Row("INS_GYROFFS_Y", 0, -0.03, 0.03, "rad/s", "gyro offset, pitch", "cal_gyr_y", reboot=True),
    Row("INS_GYROFFS_Z", 0, -0.03, 0.03, "rad/s", "gyro offset, yaw", "cal_gyr_z", reboot=True),
    Row("COMPASS_OFS_X", 0, -100, 100, "mGauss", "compass offset, forward", "cal_mag_x", 0.001, reboot=True),
    Row("COMPASS_OFS_Y", 0, -100, 100, "mGauss", "compass offset, right", "cal_mag_y", 0.001, reboot=True),
    Row("COMPASS_OFS_Z", 0, -100, 100, "mGauss", "compass offset, down", "cal_mag_z", 0.001, reboot=True),
    Row("GPS_POS1_X", 0, -5, 5, "m", "GPS antenna forward of the centre", "gps_lever_x", reboot=True),
    Row("GPS_POS1_Y", 0, -5, 5, "m", "GPS antenna right of the centre", "gps_lever_y", reboot=True),
    Row("GPS_POS1_Z", 0, -5, 5, "m", "GPS antenna below the centre", "gps_lever_z", reboot=True),
)
