"""The signals a trace may hold: name, unit, meaning. Flights write these names, policies and recordings read them.

Angles are degrees; yaw is the compass heading (0 north, 90 east); positions are x north, y east, altitude up from
the take-off point. `*_est_*` is what the autopilot believes, the plain name is the truth of the world.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal, NamedTuple

Kind = Literal["real", "flag", "code"]


class Signal(NamedTuple):
    """One row of the table; `kind` is real, flag (0 or 1) or code (a number from a closed list such as a mode)."""

    unit: str
    meaning: str
    kind: Kind = "real"


SIGNALS: dict[str, Signal] = {
    "x_m": Signal("m", "position north"),
    "y_m": Signal("m", "position east"),
    "altitude_m": Signal("m", "height above the take-off point"),
    "above_ground_m": Signal("m", "height above the ground under the vehicle: of logs, where it stood or came to lie"),
    "vx_mps": Signal("m/s", "velocity north"),
    "vy_mps": Signal("m/s", "velocity east"),
    "climb_mps": Signal("m/s", "vertical speed, up positive"),
    "roll_deg": Signal("deg", "roll angle"),
    "pitch_deg": Signal("deg", "pitch angle"),
    "yaw_deg": Signal("deg", "heading, 0..360"),
    "roll_rate_dps": Signal("deg/s", "roll rate"),
    "pitch_rate_dps": Signal("deg/s", "pitch rate"),
    "yaw_rate_dps": Signal("deg/s", "yaw rate"),
    "obstacle_distance_m": Signal(
        "m", "competition distance: to the full boxes in the plane, or above the top when over a box; 1000 if none"
    ),
    "contact": Signal("", "1 while touching the solid core of a box (0.8 x the seen box)", "flag"),
    "mode": Signal("", "flight mode, ArduCopter's numbers", "code"),
    "armed": Signal("", "1 while motors are armed", "flag"),
    "landed": Signal("", "1 while the autopilot believes to stand on the ground", "flag"),
    "throttle": Signal("", "collective command, 0..1"),
    "mission_item": Signal("", "index of the current mission item", "code"),
    # what the autopilot believes and aims at
    "x_est_m": Signal("m", "position north as estimated"),
    "y_est_m": Signal("m", "position east as estimated"),
    "altitude_est_m": Signal("m", "height above home as estimated"),
    "climb_est_mps": Signal("m/s", "vertical speed as estimated, up positive"),
    "altitude_target_m": Signal("m", "height the altitude controller aims at; the estimate where it aims at none"),
    "altitude_source": Signal(
        "", "height source asked for (EK2_ALT_SOURCE): 0 barometer, 1 range finder, 2 GPS, 3 vision", "code"
    ),
    "home_distance_m": Signal("m", "true distance in the plane to the home position in force"),
    "circle_radius_m": Signal("m", "radius the CIRCLE mode aims at; 0 outside the mode"),
    "circle_rate_dps": Signal("deg/s", "turning rate the CIRCLE mode aims at, clockwise positive; 0 outside the mode"),
    "mission_count": Signal("", "number of mission items on board", "code"),
    "taken_off": Signal("", "1 once the vehicle has left the ground since it was armed", "flag"),
    "takeoff": Signal("", "1 while a commanded take-off climb runs (MAV_CMD_NAV_TAKEOFF)", "flag"),
    # what the sensors and the radio say
    "gps_altitude_m": Signal("m", "height above home as the GPS receiver reports it"),
    "baro_altitude_m": Signal("m", "height above home as the barometer reports it"),
    "gps_satellites": Signal("", "satellites used by the receiver", "code"),
    "gps_ok": Signal("", "1 while the receiver reports a usable position", "flag"),
    "position_aided": Signal(
        "", "1 while something else than the satellites gives the position, too (optical flow, vision, beacons)", "flag"
    ),
    "innovation_ratio": Signal("", "how far satellites and estimate are apart, as a share of what passes for noise"),
    "baro_ok": Signal("", "1 while the barometer answers", "flag"),
    "battery_v": Signal("V", "battery voltage"),
    "rc1_pwm": Signal("us", "roll stick as received, 1000..2000, 1500 centre"),
    "rc2_pwm": Signal("us", "pitch stick as received, 1000..2000, 1500 centre, below is forward"),
    "rc3_pwm": Signal("us", "throttle stick as received, 1000..2000"),
    "rc4_pwm": Signal("us", "yaw stick as received, 1000..2000, 1500 centre"),
    "rc_present": Signal("", "1 while the radio link delivers stick values", "flag"),
    # failsafes and the parachute
    "failsafe_gps": Signal("", "1 while the GPS/EKF failsafe is raised", "flag"),
    "failsafe_radio": Signal("", "1 while the radio failsafe is raised", "flag"),
    "failsafe_battery": Signal("", "1 while the battery failsafe is raised", "flag"),
    "failsafe_fence": Signal("", "1 while the fence is breached and acted upon", "flag"),
    "chute_released": Signal("", "1 once the parachute was released (MAV_CMD_DO_PARACHUTE)", "flag"),
    # settings in force, read from the parameters on board (as the autopilot stores them, in SI units)
    "rtl_altitude_set_m": Signal("m", "return altitude (RTL_ALT)"),
    "rtl_altitude_final_set_m": Signal("m", "altitude RTL ends at, 0 to land (RTL_ALT_FINAL)"),
    "land_speed_set_mps": Signal("m/s", "final descent speed (LAND_SPEED)"),
    "land_speed_high_set_mps": Signal("m/s", "descent speed above 10 m (LAND_SPEED_HIGH, or WPNAV_SPEED_DN if 0)"),
    "land_altitude_low_set_m": Signal("m", "height below which LAND takes the final speed (LAND_ALT_LOW)"),
    "pilot_speed_up_set_mps": Signal("m/s", "greatest climb rate a pilot may ask (PILOT_SPEED_UP)"),
    "takeoff_altitude_set_m": Signal("m", "height the running or last take-off was ordered to"),
    "takeoff_speed_set_mps": Signal("m/s", "climb speed of a take-off (WPNAV_SPEED_UP)"),
    "chute_altitude_min_set_m": Signal("m", "least height for the parachute (CHUTE_ALT_MIN)"),
    "fs_throttle_set_pwm": Signal("us", "throttle value below which the radio counts as lost (FS_THR_VALUE)"),
    "fs_throttle_enabled": Signal("", "radio failsafe action, 0 off (FS_THR_ENABLE)", "code"),
    "fs_gps_action": Signal(
        "", "GPS/EKF failsafe action: 1 land, 2 hold altitude, 3 land always (FS_EKF_ACTION)", "code"
    ),
    "fs_gps_delay_set_s": Signal("s", "time from loss of position to the failsafe (COM_POS_FS_DELAY)"),
    "fence_enabled": Signal("", "1 while the altitude fence is on (FENCE_ENABLE)", "flag"),
    "fence_altitude_max_set_m": Signal("m", "ceiling of the fence (FENCE_ALT_MAX)"),
    "battery_low_set_v": Signal("V", "voltage below which the battery counts as low, 0 off (BATT_LOW_VOLT)"),
    "rtl_descend_altitude_set_m": Signal(
        "m", "PX4: height above home RTL descends to before landing (RTL_DESCEND_ALT)"
    ),
    "hold_altitude_min_set_m": Signal("m", "PX4: least height of HOLD, -1 off (MIS_LTRMIN_ALT)"),
    "takeoff_slow_set_m": Signal("m", "PX4: height above which a take-off is no slower than any climb (MPC_LAND_ALT1)"),
    "fs_action_delay_set_s": Signal("s", "PX4: time in HOLD before the action of a failsafe (COM_FAIL_ACT_T), else 0"),
    # how far the twin of a test case flew from it at the same moment, turned back; written where a twin was flown
    "twin": Signal(
        "",
        "which twin flies: 1 turned by a right angle, 2 without what does nothing, 3 without what came before, "
        "4 mirrored, 5 by another radio",
        "code",
    ),
    "twin_x_apart_m": Signal("m", "how far north of the flight its twin is"),
    "twin_y_apart_m": Signal("m", "how far east of the flight its twin is"),
    "twin_height_apart_m": Signal("m", "how far above the flight its twin is"),
    "twin_heading_apart_deg": Signal("deg", "how far the twin's heading is clockwise of that of the flight, -180..180"),
    "twin_mode_apart": Signal("", "1 where the twin flies another mode", "flag"),
    "twin_armed_apart": Signal("", "1 where the motors of one of the two are on and those of the other off", "flag"),
    # made by the oracle from the rest of the trace, the test case and the ending; flights need not write them
    "time_s": Signal("s", "time since the start of the flight"),
    "ground_speed_mps": Signal("m/s", "speed in the plane"),
    "forward_mps": Signal("m/s", "speed over ground the way the nose points"),
    "right_mps": Signal("m/s", "speed over ground to the right of where the nose points"),
    "tilt_deg": Signal("deg", "angle between the vehicle's axis and the vertical"),
    "quiet_s": Signal(
        "s", "time since the last stimulus was given and not denied (since the start where there was none)"
    ),
    "battery_timer_set_s": Signal("s", "time below the low voltage until the failsafe (BATT_LOW_TIMER)"),
    "battery_low_action_set": Signal("", "low battery: 0 warn, 1 LAND, 2 RTL (BATT_FS_LOW_ACT)", "code"),
    "battery_critical_set_v": Signal("V", "voltage that counts as critical, 0 off (BATT_CRT_VOLT)"),
    "battery_critical_action_set": Signal("", "critical battery: 0 warn, 1 LAND, 2 RTL (BATT_FS_CRT_ACT)", "code"),
    "acro_trainer_set": Signal("", "ACRO: 1 levels itself, 2 limits its lean too, 0 neither (ACRO_TRAINER)", "code"),
    "acro_balance_roll_set": Signal("", "how fast roll levels itself in ACRO, 1/s (ACRO_BAL_ROLL)"),
    "acro_balance_pitch_set": Signal("", "how fast pitch levels itself in ACRO, 1/s (ACRO_BAL_PITCH)"),
    "acro_rate_set_dps": Signal("deg/s", "roll or pitch rate of a full stick in ACRO (ACRO_RP_P)"),
    "acro_expo_set": Signal("", "how much of a stick in ACRO counts by its third power (ACRO_RP_EXPO)"),
    "chute_enabled_set": Signal("", "1 while a parachute is fitted (CHUTE_ENABLED)", "flag"),
    "chute_type_set": Signal("", "what releases the parachute: 0 to 3 a relay, 10 a servo (CHUTE_TYPE)", "code"),
    "chute_servo_set": Signal("", "what output 9 does, 27 the parachute (SERVO9_FUNCTION)", "code"),
    "chute_delay_set_s": Signal("s", "time from the order to the canopy (CHUTE_DELAY_MS)"),
    "chute_present_set": Signal("", "1 while the simulated vehicle carries a parachute (SIM_PARA_ENABLE)", "flag"),
    "chute_sink_set_mps": Signal("m/s", "sink rate that releases the parachute, 0 none (CHUTE_CRT_SINK)"),
    "radio_fault_set": Signal("", "how the simulated radio fails: 1 silent, 2 throttle low (SIM_RC_FAIL)", "code"),
    "battery_low_charge_set_mah": Signal("mAh", "charge left that counts as low, 0 off (BATT_LOW_MAH)"),
    "battery_capacity_set_mah": Signal("mAh", "charge of a full battery (BATT_CAPACITY)"),
    "fence_action_set": Signal("", "breach: 0 report, 1 RTL or LAND, 2 LAND, 4 BRAKE (FENCE_ACTION)", "code"),
    "failsafe_options_set": Signal("", "bits: in which modes a failsafe does nothing (FS_OPTIONS)", "code"),
    "circle_options_set": Signal("", "bits: 1 sticks change the circle, 2 nose along it (CIRCLE_OPTIONS)", "code"),
    "auto_options_set": Signal("", "bits: 4 the yaw stick does nothing in AUTO (AUTO_OPTIONS)", "code"),
    "pilot_turn_speed_set_dps": Signal("deg/s", "turning speed of a full yaw stick (PILOT_Y_RATE)"),
    "fence_on_set": Signal("", "1 while fences are on (FENCE_ENABLE)", "flag"),
    "fence_type_set": Signal("", "bits: 1 ceiling, 2 circle about home, 4 polygons, 8 floor (FENCE_TYPE)", "code"),
    "throttle_filter_set_hz": Signal("Hz", "filter of the throttle stick, 0 off (PILOT_THR_FILT)"),
    "yaw_rate_max_set_dps": Signal("deg/s", "how fast it may turn (ATC_RATE_Y_MAX); 0: no bound"),
    "yaw_acceleration_set_dps2": Signal("deg/s2", "how fast a turn may speed up (ATC_ACCEL_Y_MAX); 0: no bound"),
    "loiter_acceleration_set_mps2": Signal("m/s2", "acceleration in LOITER (LOIT_ACC_MAX)"),
    "landed_disarms_set": Signal("", "bits: 4 motors off in all modes once landed (PILOT_THR_BHV)", "code"),
    "fence_margin_set_m": Signal("m", "distance that modes keep from the fence (FENCE_MARGIN)"),
    "acro_yaw_rate_set_dps": Signal("deg/s", "yaw rate that a full stick asks for in ACRO (ACRO_YAW_P)"),
    "fence_altitude_min_set_m": Signal("m", "floor of the fence (FENCE_ALT_MIN)"),
    "fence_points_set": Signal("", "points of polygons and circles loaded as fences (FENCE_TOTAL)", "code"),
    "fence_radius_set_m": Signal("m", "radius of the circle about home (FENCE_RADIUS)"),
    "variance_set": Signal("", "innovation ratio from which on the position counts as lost (FS_EKF_THRESH)"),
    "arming_checks_set": Signal("", "checks before arming, 0 none (ARMING_CHECK)", "code"),
    "angle_max_set_deg": Signal("deg", "greatest lean angle (ANGLE_MAX)"),
    "waypoint_radius_set_m": Signal("m", "distance at which a way-point counts as reached (WPNAV_RADIUS)"),
    "acceleration_set_mps2": Signal("m/s2", "acceleration of autonomous modes in the plane (WPNAV_ACCEL)"),
    "stopping_s": Signal(
        "s", "time in which it can be asked to stop from its speed and lean now, by the settings in force"
    ),
    "settling_s": Signal("s", "time in which it can be asked to stop and to come back to where it was"),
    "pilot_takeoff_set_m": Signal("m", "height to which a pilot's take-off climbs by itself (PILOT_TKOFF_ALT)"),
    "pilot_acceleration_set_mps2": Signal("m/s2", "how hard a climb by stick speeds up and stops (PILOT_ACCEL_Z)"),
    "climb_acceleration_set_mps2": Signal("m/s2", "how hard any climb speeds up and stops (WPNAV_ACCEL_Z)"),
    "yaw_slew_set_dps": Signal("deg/s", "turning speed of autonomous modes (ATC_SLEW_YAW)"),
    "pilot_speed_down_set_mps": Signal("m/s", "greatest descent rate a pilot may ask (PILOT_SPEED_DN)"),
    "cruise_speed_set_mps": Signal("m/s", "speed of autonomous modes (WPNAV_SPEED, MAV_CMD_DO_CHANGE_SPEED)"),
    "return_speed_set_mps": Signal("m/s", "speed of a return (RTL_SPEED, or that of autonomous modes if 0)"),
    "return_wait_set_s": Signal("s", "wait over home before a return descends (RTL_LOIT_TIME)"),
    "return_climb_min_set_m": Signal("m", "least climb before a return (RTL_CLIMB_MIN)"),
    "loiter_speed_set_mps": Signal("m/s", "greatest speed in LOITER (LOIT_SPEED)"),
    "loiter_brake_set_mps2": Signal("m/s2", "how hard LOITER brakes with the sticks let go (LOIT_BRK_ACCEL)"),
    "wind_set_mps": Signal("m/s", "wind that is simulated (SIM_WIND_SPD)"),
    "gusts_set_mps": Signal("m/s", "gusts that are simulated (SIM_WIND_TURB)"),
    "disarm_delay_set_s": Signal("s", "time on the ground before disarming, 0 never (DISARM_DELAY)"),
    "circle_radius_set_m": Signal("m", "radius of CIRCLE when it is entered (CIRCLE_RADIUS)"),
    "roll_rate_max_set_dps": Signal("deg/s", "how fast it may roll (ATC_RATE_R_MAX); 0: no bound"),
    "roll_acceleration_set_dps2": Signal("deg/s2", "how fast a roll may speed up (ATC_ACCEL_R_MAX); 0: no bound"),
    "gps_noise_set_m": Signal("m", "how much noise the satellites' positions are given (SIM_GPS_NOISE)"),
    "hover_throttle_set": Signal("", "share of full throttle that the middle of the stick stands for (MOT_THST_HOVER)"),
    "pitch_rate_max_set_dps": Signal("deg/s", "how fast it may pitch (ATC_RATE_P_MAX); 0: no bound"),
    "pitch_acceleration_set_dps2": Signal("deg/s2", "how fast a pitch may speed up (ATC_ACCEL_P_MAX); 0: no bound"),
    "gps_forward_set_m": Signal("m", "how far before the middle the antenna is said to be (GPS_POS1_X)"),
    "gps_right_set_m": Signal("m", "how far to the right of the middle the antenna is said to be (GPS_POS1_Y)"),
    "roll_stick_min_set_us": Signal("us", "roll stick fully left (RC1_MIN)"),
    "roll_stick_max_set_us": Signal("us", "roll stick fully right (RC1_MAX)"),
    "pitch_stick_min_set_us": Signal("us", "pitch stick fully forward (RC2_MIN)"),
    "pitch_stick_max_set_us": Signal("us", "pitch stick fully back (RC2_MAX)"),
    "trim_roll_set_deg": Signal("deg", "roll offset of the board (AHRS_TRIM_X)"),
    "trim_pitch_set_deg": Signal("deg", "pitch offset of the board (AHRS_TRIM_Y)"),
    "circle_rate_set_dps": Signal("deg/s", "turning rate of CIRCLE at its entry, clockwise positive (CIRCLE_RATE)"),
    "descent_speed_set_mps": Signal("m/s", "descent speed of autonomous modes (WPNAV_SPEED_DN)"),
    "order_quiet_s": Signal("s", "time since the last command, mode or stick was given and not denied"),
    "command_quiet_s": Signal(
        "s", "time since the last command was given and not denied, above 1,000,000 where there was none"
    ),
    "divert_order_s": Signal("s", "as command_quiet_s; orders to turn, to look or how fast to fly do not count"),
    "calm_s": Signal("s", "time since the last input that can move the vehicle or what it believes"),
    "home_quiet_s": Signal("s", "time since another home was given, above 1,000,000 where none was"),
    "place_order_s": Signal("s", "time since the last order to go to a place, above 1,000,000 where none was given"),
    "ordered_x_m": Signal("m", "north of the place ordered last (MAV_CMD_DO_REPOSITION)"),
    "ordered_y_m": Signal("m", "east of the place ordered last"),
    "ordered_altitude_m": Signal("m", "height of the place ordered last, above home"),
    "yaw_order_s": Signal("s", "time since the last order to turn, above 1,000,000 where none was given"),
    "pause_order_s": Signal(
        "s",
        "time since a pause that no order to go on followed (MAV_CMD_DO_PAUSE_CONTINUE), above 1,000,000 without one",
    ),
    "ordered_yaw_way": Signal("", "way round to it that was ordered: 1 clockwise, -1 the other, 0 the shorter", "code"),
    "ordered_yaw_deg": Signal("deg", "heading ordered last (MAV_CMD_CONDITION_YAW, MAV_CMD_DO_SET_ROI)"),
    "mode_order_s": Signal(
        "s", "time since the last order to take a mode, denied or not, above 1,000,000 where none was given"
    ),
    "mode_cause_s": Signal(
        "s", "time since the last stick, mode or command that may change the mode was given and not denied"
    ),
    "ordered_mode": Signal("", "mode ordered last, denied or not", "code"),
    **{
        f"rc{channel}_sent_pwm": Signal(
            "us", f"where the {stick} stick was put last (RC{channel}), 0 before the first time"
        )
        for channel, stick in enumerate(("roll", "pitch", "throttle", "yaw"), 1)
    },
    "plain_order": Signal(
        "",
        "order given last whose numbers leave no doubt, denied or not: 1 arm, 2 take off, 3 go to a place, 4 turn, "
        "5 fly as fast, 6 flip, 7 begin the mission, 8 home is there, 9 pause or go on, 10 the fence off or on; 0 none",
        "code",
    ),
    "plain_order_s": Signal("s", "time since that order, above 1,000,000 where none was given"),
    "plain_order_refused": Signal("", "1 where that order was refused", "flag"),
    "release_order_s": Signal(
        "s", "time since the parachute was last ordered out, denied or not, above 1,000,000 where it never was"
    ),
    "stop_order_s": Signal(
        "s", "time since the motors were last ordered off come what may, denied or not, above 1,000,000 where never"
    ),
    "climb_order_s": Signal(
        "s", "time since a speed was ordered to climb or sink at (MAV_CMD_DO_CHANGE_SPEED), above 1,000,000 where never"
    ),
    "height_order_s": Signal(
        "s",
        "time since an order to take off or to another height (MAV_CMD_NAV_TAKEOFF, MAV_CMD_DO_CHANGE_ALTITUDE, or "
        "MAV_CMD_DO_REPOSITION with the flag that asks for its mode), above 1,000,000 where none was given",
    ),
    "start_order_s": Signal("s", "time since the mission was last ordered to begin, above 1,000,000 where never"),
    "ordered_home_m": Signal(
        "m",
        "distance in the plane to what home must be: where the motors were started, or as MAV_CMD_DO_SET_HOME gave it",
    ),
    "item_command": Signal("", "MAV_CMD number of the mission item at hand, 0 where there is none", "code"),
    "item_heading_deg": Signal("deg", "heading that the mission item at hand asks to wait with, -1 where it asks none"),
    "item_wait_s": Signal("s", "time that the mission item at hand asks to wait where it is, 0 if none"),
    "item_speed_mps": Signal(
        "m/s", "speed that the mission has ordered before the item at hand, -1 where it ordered none"
    ),
    "item_off_m": Signal("m", "distance in the plane to the way-point at hand as estimated, -1 where the item is none"),
    "item_height_off_m": Signal("m", "distance in height to the way-point at hand, -1 where the item is none"),
    "item_landing_off_m": Signal(
        "m", "distance in the plane to where the mission item at hand lands, -1 where it does not, or where it is"
    ),
    "item_unexpected": Signal("", "1 where the mission item at hand is not the one that had to follow", "flag"),
    "gps_true": Signal("", "0 while a stimulus falsifies the GPS", "flag"),
    "gps_settled": Signal("", "0 until the estimate has followed what a stimulus did to the GPS", "flag"),
    "baro_true": Signal("", "0 while a stimulus falsifies the barometer", "flag"),
    "baro_settled": Signal("", "0 until the estimate has followed what a stimulus did to the barometer", "flag"),
    "sticks_true": Signal("", "0 while the centre or sense of a stick is set otherwise (RC1_TRIM, ...)", "flag"),
    "ends_true": Signal(
        "", "0 while the sense of a stick or an end of the throttle is set otherwise (RC3_MAX)", "flag"
    ),
    "stop_ordered": Signal("", "1 from the first order to stop the motors come what may", "flag"),
    "arming_forced": Signal("", "1 from the first order to arm without checks", "flag"),
    "body_true": Signal(
        "",
        "0 while inertial sensors or compass are falsified, motors hurt, it storms, or AHRS_TRIM takes up ANGLE_MAX",
        "flag",
    ),
    "crashed": Signal("", "1 at the last sample of a flight that ended as crashed", "flag"),
}

FAILSAFES = tuple(name for name, row in SIGNALS.items() if name.startswith("failsafe_") and row.kind == "flag")
"""Those that say whether a failsafe is raised; others of such names say how one is set."""

TWIN_SIGNALS = tuple(name for name in SIGNALS if name.startswith("twin"))
"""Those that say how a flight and its twin differ: no target writes them itself."""

MODES: dict[str, int] = {
    "STABILIZE": 0,
    "ACRO": 1,
    "ALT_HOLD": 2,
    "AUTO": 3,
    "GUIDED": 4,
    "LOITER": 5,
    "RTL": 6,
    "CIRCLE": 7,
    "LAND": 9,
    "DRIFT": 11,
    "SPORT": 13,
    "FLIP": 14,
    "BRAKE": 17,
    "SMART_RTL": 21,
    "AUTO_RTL": 27,
}
UNNAMED_MODE = "mode "
"""Before the number of a mode that is none of these, where a state is told in words."""

_OF_STIMULI = """
time_s quiet_s order_quiet_s command_quiet_s divert_order_s calm_s home_quiet_s crashed stop_ordered arming_forced
gps_true gps_settled baro_true baro_settled body_true sticks_true ends_true place_order_s pause_order_s ordered_x_m
ordered_y_m ordered_altitude_m battery_timer_set_s battery_low_action_set battery_critical_set_v
battery_low_charge_set_mah battery_capacity_set_mah battery_critical_action_set acro_trainer_set acro_balance_roll_set
acro_balance_pitch_set acro_rate_set_dps acro_expo_set chute_enabled_set chute_type_set chute_servo_set
chute_delay_set_s chute_present_set radio_fault_set pilot_acceleration_set_mps2 climb_acceleration_set_mps2
mode_order_s mode_cause_s ordered_mode release_order_s stop_order_s start_order_s climb_order_s height_order_s
position_aided plain_order plain_order_s plain_order_refused takeoff_slow_set_m fs_action_delay_set_s
failsafe_options_set circle_options_set auto_options_set pilot_turn_speed_set_dps fence_action_set fence_on_set
fence_type_set fence_radius_set_m fence_margin_set_m acro_yaw_rate_set_dps fence_altitude_min_set_m fence_points_set
landed_disarms_set throttle_filter_set_hz yaw_rate_max_set_dps yaw_acceleration_set_dps2 loiter_acceleration_set_mps2
loiter_brake_set_mps2 wind_set_mps gusts_set_mps arming_checks_set variance_set angle_max_set_deg
acceleration_set_mps2 waypoint_radius_set_m cruise_speed_set_mps return_speed_set_mps return_climb_min_set_m
return_wait_set_s loiter_speed_set_mps disarm_delay_set_s pilot_takeoff_set_m yaw_slew_set_dps circle_radius_set_m
circle_rate_set_dps descent_speed_set_mps trim_roll_set_deg trim_pitch_set_deg gps_forward_set_m gps_right_set_m
chute_sink_set_mps roll_stick_min_set_us roll_stick_max_set_us pitch_stick_min_set_us pitch_stick_max_set_us
roll_acceleration_set_dps2 roll_rate_max_set_dps gps_noise_set_m hover_throttle_set pitch_acceleration_set_dps2
pitch_rate_max_set_dps rc1_sent_pwm rc2_sent_pwm rc3_sent_pwm rc4_sent_pwm
"""
MADE_FROM: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(_OF_STIMULI.split(), ()),
    "pilot_speed_down_set_mps": ("pilot_speed_up_set_mps",),
    "item_command": ("mission_item",),
    "item_heading_deg": ("mission_item", "yaw_deg"),
    "item_wait_s": ("mission_item",),
    "item_speed_mps": ("mission_item",),
    "item_off_m": ("mission_item", "x_est_m", "y_est_m"),
    "item_height_off_m": ("mission_item", "altitude_est_m"),
    "item_landing_off_m": ("mission_item", "x_m", "y_m"),
    "ordered_home_m": ("x_m", "y_m", "armed"),
    "item_unexpected": ("mission_item", "mode", "x_est_m", "y_est_m", "altitude_est_m"),
    "yaw_order_s": ("yaw_deg", "x_m", "y_m"),
    "ordered_yaw_deg": ("yaw_deg", "x_m", "y_m"),
    "ordered_yaw_way": ("yaw_deg", "x_m", "y_m"),
    "ground_speed_mps": ("vx_mps", "vy_mps"),
    "forward_mps": ("vx_mps", "vy_mps", "yaw_deg"),
    "right_mps": ("vx_mps", "vy_mps", "yaw_deg"),
    "stopping_s": ("vx_mps", "vy_mps", "roll_deg", "pitch_deg"),
    "settling_s": ("vx_mps", "vy_mps", "roll_deg", "pitch_deg"),
    "home_distance_m": ("x_m", "y_m"),
    "tilt_deg": ("roll_deg", "pitch_deg"),
    "obstacle_distance_m": ("x_m", "y_m", "altitude_m"),
    "above_ground_m": ("altitude_m",),
    "x_est_m": ("x_m",),
    "y_est_m": ("y_m",),
    "altitude_est_m": ("altitude_m",),
    "climb_est_mps": ("climb_mps",),
}
"""What the oracle makes of the rest of a flight where the trace does not hold it, and the signals each is made from."""


GRID: dict[str, int] = {"m": 1024, "m/s": 1024, "deg": 256, "deg/s": 64, "V": 1024, "": 4096}
"""By unit: flights record these parts of it (1 mm, 0.004 deg, ...). A number's last bits say nothing about the flight
and are most of what a compressed trace would weigh."""


def grid(name: str) -> int:
    """Return in which parts of its unit flights record a signal; 0: as it is (settings in force, codes, times)."""
    signal = SIGNALS.get(name)
    if signal is None or signal.kind != "real" or "_set_" in name:
        return 0
    return GRID.get(signal.unit, 0)


def lacking(name: str, written: Collection[str]) -> tuple[str, ...]:
    """Return the signals that a flight would have to hold for it to give `name`, and does not."""
    sources = MADE_FROM.get(name)
    if name in written:
        return ()
    if not sources:
        return () if sources == () else (name,)
    return tuple(leaf for source in sources for leaf in lacking(source, written))


def can_show(name: str, written: Collection[str]) -> bool:
    """Return whether a flight whose trace holds `written` can give a signal."""
    sources = MADE_FROM.get(name)
    return name in written or (sources is not None and all(can_show(source, written) for source in sources))
