"""The signals of a trace: the truth and the common names, and some of the firmware's own."""

from __future__ import annotations

from collections.abc import Mapping

from saflite.contract.signals import SIGNALS
from saflite.contract.target_info import SignalInfo
from saflite.flight.autopilots.betaflight.vehicle import Vehicle
from saflite.flight.native_library import Board

_NOT_WRITTEN = frozenset({"time_s", "obstacle_distance_m", "contact", "chute_released", "gps_satellites"})

OWN_SIGNALS: dict[str, SignalInfo] = {
    "box_angle": SignalInfo(meaning="1 while ANGLE is active", kind="flag"),
    "box_horizon": SignalInfo(meaning="1 while HORIZON is active", kind="flag"),
    "box_altitude_hold": SignalInfo(meaning="1 while ALTHOLD is active", kind="flag"),
    "box_position_hold": SignalInfo(meaning="1 while POSHOLD is active", kind="flag"),
    "box_rescue": SignalInfo(meaning="1 while GPS rescue is active", kind="flag"),
    "arming_forbidden": SignalInfo(
        meaning="1 while any arming flag but the latch of the switch is raised", kind="flag"
    ),
    "runaway_stopped": SignalInfo(
        meaning="1 while runaway take-off prevention, which disarmed, forbids arming", kind="flag"
    ),
    "crash_stopped": SignalInfo(meaning="1 while crash recovery, which disarmed, forbids arming", kind="flag"),
    "settings_lost": SignalInfo(
        meaning="settings that the command line took but that read otherwise after the next power-up", kind="code"
    ),
    "height_tune_usual": SignalInfo(
        meaning="1 where gains, filters and throttle of the height's control are near what holds our F450", kind="flag"
    ),
    "race_mode_set": SignalInfo(meaning="1 where ANGLE levels roll only (level_race_mode)", kind="flag"),
    "runaway_prevention_set": SignalInfo(meaning="1 where runaway_takeoff_prevention is on", kind="flag"),
    "runaway_throttle_set_percent": SignalInfo(
        unit="percent", meaning="throttle of a take-off (runaway_takeoff_deactivate_throttle_percent)"
    ),
    "crash_recovery_set": SignalInfo(meaning="crash_recovery: 0 off, 1 on, 2 beep, 3 disarm", kind="code"),
    "rc_valid": SignalInfo(meaning="1 while the link delivers pulses of flight channels within range", kind="flag"),
    "arm_switch": SignalInfo(meaning="1 while the pilot's arm switch is on", kind="flag"),
    "failsafe_switch": SignalInfo(meaning="1 while the pilot's failsafe switch is on", kind="flag"),
    "rescue_switch": SignalInfo(meaning="1 while the pilot's rescue switch is on", kind="flag"),
    "rx_roll_us": SignalInfo(unit="us", meaning="roll channel as the firmware uses it"),
    "rx_pitch_us": SignalInfo(unit="us", meaning="pitch channel as the firmware uses it"),
    "rx_throttle_us": SignalInfo(unit="us", meaning="throttle channel as the firmware uses it"),
    "rx_yaw_us": SignalInfo(unit="us", meaning="yaw channel as the firmware uses it"),
    "telemetry_age_s": SignalInfo(unit="s", meaning="time since the firmware last told its state"),
    "firmware_s": SignalInfo(unit="s", meaning="the firmware's own clock"),
    "angle_limit_set_deg": SignalInfo(unit="deg", meaning="greatest lean angle in ANGLE (angle_limit)"),
    "failsafe_delay_set_s": SignalInfo(unit="s", meaning="loss of signal until stage 2 (failsafe_delay)"),
    "failsafe_recovery_set_s": SignalInfo(unit="s", meaning="signal back until control (failsafe_recovery_delay)"),
    "failsafe_procedure": SignalInfo(
        meaning="stage 2 (failsafe_procedure): 0 AUTO-LAND, 1 DROP, 2 GPS-RESCUE", kind="code"
    ),
    "failsafe_switch_mode": SignalInfo(
        meaning="the failsafe box (failsafe_switch_mode): 0 stage 1, 1 kill, 2 stage 2", kind="code"
    ),
    "failsafe_landing_set_s": SignalInfo(unit="s", meaning="time AUTO-LAND takes (failsafe_landing_time)"),
    "auto_disarm_set_s": SignalInfo(unit="s", meaning="idle on the ground until disarmed (auto_disarm_delay)"),
    "rescue_sanity_checks": SignalInfo(
        meaning="gps_rescue_sanity_checks: 0 off, 1 on, 2 in failsafe only", kind="code"
    ),
    "rescue_descend_set_mps": SignalInfo(unit="m/s", meaning="rescue's speed of descent (gps_rescue_descend_rate)"),
    "rescue_angle_set_deg": SignalInfo(unit="deg", meaning="rescue's greatest lean angle (gps_rescue_max_angle)"),
}

SHOWN_SETTINGS: dict[str, tuple[str, float]] = {
    "angle_limit_set_deg": ("angle_limit", 1.0),
    "failsafe_delay_set_s": ("failsafe_delay", 0.1),
    "failsafe_recovery_set_s": ("failsafe_recovery_delay", 0.1),
    "failsafe_procedure": ("failsafe_procedure", 1.0),
    "failsafe_switch_mode": ("failsafe_switch_mode", 1.0),
    "failsafe_landing_set_s": ("failsafe_landing_time", 1.0),
    "auto_disarm_set_s": ("auto_disarm_delay", 1.0),
    "rescue_sanity_checks": ("gps_rescue_sanity_checks", 1.0),
    "rescue_descend_set_mps": ("gps_rescue_descend_rate", 0.01),
    "rescue_angle_set_deg": ("gps_rescue_max_angle", 1.0),
    "race_mode_set": ("level_race_mode", 1.0),
    "runaway_prevention_set": ("runaway_takeoff_prevention", 1.0),
    "runaway_throttle_set_percent": ("runaway_takeoff_deactivate_throttle_percent", 1.0),
    "crash_recovery_set": ("crash_recovery", 1.0),
    "rx_min_set_us": ("rx_min_usec", 1.0),
    "rx_max_set_us": ("rx_max_usec", 1.0),
}
"""Slot of the bridge to the setting it shows and the scale to its unit."""

HEIGHT_TUNE: dict[str, tuple[float, float]] = {
    "ap_altitude_p": (8.0, 30.0),
    "ap_altitude_i": (5.0, 20.0),
    "ap_altitude_d": (15.0, 30.0),
    "altitude_lpf": (100.0, 1000.0),
    "altitude_d_lpf": (80.0, 1000.0),
    "ap_hover_throttle": (1370.0, 1470.0),
    "ap_throttle_min": (1050.0, 1250.0),
    "ap_throttle_max": (1600.0, 2000.0),
}
"""Ranges at whose ends ALTHOLD kept our F450's height within 2 m in flights. Documented ones reach past what holds any
vehicle: with `ap_altitude_d` 10 it swung by 5 m, with `ap_altitude_i` 30 and half the usual D by 6 m."""


def height_tune_usual(set_up: Mapping[str, float]) -> bool:
    """Return whether the settings given, beside defaults, leave the control of height a usual tune."""
    return all(low <= set_up.get(name, low) <= high for name, (low, high) in HEIGHT_TUNE.items())


def show_setting(board: Board, name: str, value: float) -> None:
    """Put a setting's value into the slots that show it."""
    for slot, (shown, scale) in SHOWN_SETTINGS.items():
        if shown == name:
            board[slot] = scale * value


def trace_names() -> tuple[str, ...]:
    """Return the signals of a trace."""
    have = Vehicle.slots()
    return (*(name for name in SIGNALS if name in have and name not in _NOT_WRITTEN), *OWN_SIGNALS)
