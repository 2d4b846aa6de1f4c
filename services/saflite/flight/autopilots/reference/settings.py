"""Settings in force, written to the trace in the units policies read; and limits that several modes share."""

from __future__ import annotations

import math

from saflite.flight.autopilots.reference.flight_stack import FlightStack

SPEED_LEAST_MPS = 0.2  # AC_WPNav: WPNAV_WP_SPEED_MIN; an order to fly more slowly is not taken
LEAST = {
    "k_rate_r_max": math.radians(60.0),
    "k_rate_p_max": math.radians(60.0),
    "k_rate_y_max": math.radians(20.0),
    "k_acc_r_max": math.radians(90.0),
    "k_acc_p_max": math.radians(90.0),
    "k_acc_y_max": math.radians(20.0),
    "k_rat_r_flte": 20.0,  # Hz
    "k_rat_p_flte": 20.0,
    "k_rat_y_flte": 1.0,
}


def publish(ap: FlightStack) -> None:
    """Write the parameters that policies look at to the board."""
    p = ap.parameters
    ap.board.set(
        rtl_altitude_set_m=p["RTL_ALT"] / 100.0,
        rtl_altitude_final_set_m=p["RTL_ALT_FINAL"] / 100.0,
        land_speed_set_mps=p["LAND_SPEED"] / 100.0,
        land_speed_high_set_mps=(p["LAND_SPEED_HIGH"] or p["WPNAV_SPEED_DN"]) / 100.0,
        land_altitude_low_set_m=p["LAND_ALT_LOW"] / 100.0,
        pilot_speed_up_set_mps=p["PILOT_SPEED_UP"] / 100.0,
        takeoff_speed_set_mps=p["WPNAV_SPEED_UP"] / 100.0,
        chute_altitude_min_set_m=p["CHUTE_ALT_MIN"],
        fs_throttle_set_pwm=p["FS_THR_VALUE"],
        fs_throttle_enabled=p["FS_THR_ENABLE"],
        fs_gps_action=p["FS_EKF_ACTION"],
        fs_gps_delay_set_s=p["COM_POS_FS_DELAY"],
        fence_enabled=1.0 if p["FENCE_ENABLE"] and int(p["FENCE_TYPE"]) & 1 else 0.0,
        fence_altitude_max_set_m=p["FENCE_ALT_MAX"],
        battery_low_set_v=p["BATT_LOW_VOLT"],
        mission_count=len(ap.mission.items) if ap.mission is not None else 0,
        tilt_max=math.radians(p["ANGLE_MAX"] / 100.0),
    )
    if "rate-limit-unchecked" not in ap.defects:
        _keep_flyable(ap)


def _keep_flyable(ap: FlightStack) -> None:
    """Raise limits that are on (not 0) but too low to fly with, as ArduCopter's attitude control does inside."""
    for name, least in LEAST.items():
        if 0.0 < ap.board[name] < least:
            ap.board[name] = least


def speeds(ap: FlightStack) -> tuple[float, float, float]:
    """Return (in the plane, up, down) of autonomous modes, m/s."""
    p = ap.parameters
    plane = ap.speed_order_mps if ap.speed_order_mps is not None else p["WPNAV_SPEED"] / 100.0
    return plane, p["WPNAV_SPEED_UP"] / 100.0, p["WPNAV_SPEED_DN"] / 100.0
