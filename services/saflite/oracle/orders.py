"""What was ordered and set, as signals: calm, orders under way, settings in force. Made of what was delivered."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Given
from saflite.contract.signals import MODES
from saflite.contract.test_case import DEFAULT_TARGET, Stimulus, TestCase
from saflite.flight.autopilots.described import default_settings
from saflite.flight.mission import to_local
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG
from saflite.oracle.courses import set_last

Array = NDArray[np.float64]
NEVER_S = 1e6
ROUNDED_UP = 0.01  # AP_Param takes 1.995 for 2: a float on the link may fall short of it
SPEED_LEAST_MPS = 0.2  # ArduCopter accepts an order to fly more slowly and does not follow it (WPNAV_WP_SPEED_MIN)
FORCE = (21196.0, 2989.0)  # magic numbers with which MAVLink forces motors off or on
DISARMS = {(81, 2), (153, 0), (154, 0)}
CUTS = {(31, 2), (32, 0), (165, 0)}
"""Auxiliary functions of ArduPilot, each with a position of its switch (low 0, middle 1, high 2): those that disarm, in
the air, too; and the emergency stop and interlock, by which the motors stand though the vehicle stays armed."""

_MOVING = re.compile(
    r"(sim_(?!batt|rc_|para))|(ahrs|atc|psc|ek\d|ins|compass|gnd|gps|mot|pilot|angle|loit|wpnav|wp|acro|thr|rc\d|baro"
    r"|mc|mpc)_"
)
_ON_THE_WAY = ("CONDITION_YAW", "DO_CHANGE_SPEED", "DO_SET_ROI", "DO_SEND_BANNER")
_STILL = ("DO_SEND_BANNER", "DO_CHANGE_SPEED", "DO_FENCE_ENABLE")


class Setting(NamedTuple):
    """A parameter that policies read: its name, the manual's default and limits, the size of its unit in SI.

    Of a `whole` one an autopilot keeps no fraction, so what was given as 1.9 acts as 1. One that is `kept` may act on
    after it was taken back, until the next start: its greatest size so far counts.
    """

    parameter: str
    default: float
    low: float = -np.inf
    high: float = np.inf
    unit: float = 1.0
    whole: bool = False
    kept: bool = False


SETTINGS: dict[str, Setting] = {
    "battery_timer_set_s": Setting("BATT_LOW_TIMER", 10.0, 0.0, 120.0, whole=True),
    "battery_low_action_set": Setting("BATT_FS_LOW_ACT", 0.0, 0.0, 7.0, whole=True),
    "battery_critical_set_v": Setting("BATT_CRT_VOLT", 0.0, 0.0),
    "battery_critical_action_set": Setting("BATT_FS_CRT_ACT", 0.0, 0.0, 7.0, whole=True),
    "acro_trainer_set": Setting("ACRO_TRAINER", 2.0, 0.0, 2.0, whole=True),
    "acro_balance_roll_set": Setting("ACRO_BAL_ROLL", 1.0, 0.0, 3.0),
    "acro_balance_pitch_set": Setting("ACRO_BAL_PITCH", 1.0, 0.0, 3.0),
    "acro_rate_set_dps": Setting("ACRO_RP_P", 4.5, 1.0, 10.0, 45.0),
    "acro_expo_set": Setting("ACRO_RP_EXPO", 0.3, -0.5, 1.0),
    "chute_enabled_set": Setting("CHUTE_ENABLED", 0.0, 0.0, 1.0, whole=True),
    "chute_type_set": Setting("CHUTE_TYPE", 0.0, 0.0, 10.0, whole=True),
    "chute_sink_set_mps": Setting("CHUTE_CRT_SINK", 0.0, 0.0, 15.0),
    "chute_delay_set_s": Setting("CHUTE_DELAY_MS", 500.0, 0.0, 5000.0, 0.001, whole=True),
    "chute_present_set": Setting("SIM_PARA_ENABLE", 1.0, 0.0, 1.0, whole=True),
    "radio_fault_set": Setting("SIM_RC_FAIL", 0.0, 0.0, 2.0, whole=True),
    "chute_servo_set": Setting("SERVO9_FUNCTION", 0.0, -1.0, 200.0, whole=True),
    "battery_low_charge_set_mah": Setting("BATT_LOW_MAH", 0.0, 0.0),
    "battery_capacity_set_mah": Setting("BATT_CAPACITY", 3300.0, 0.0, whole=True),
    "fence_action_set": Setting("FENCE_ACTION", 1.0, 0.0, 5.0, whole=True),
    "failsafe_options_set": Setting("FS_OPTIONS", 16.0, 0.0, 127.0, whole=True),
    "circle_options_set": Setting("CIRCLE_OPTIONS", 1.0, 0.0, 15.0, whole=True),
    "auto_options_set": Setting("AUTO_OPTIONS", 0.0, 0.0, 255.0, whole=True),
    "pilot_turn_speed_set_dps": Setting("PILOT_Y_RATE", 202.5, 1.0, 360.0, whole=True),
    "fence_on_set": Setting("FENCE_ENABLE", 0.0, 0.0, 1.0, whole=True),
    "fence_type_set": Setting("FENCE_TYPE", 7.0, 0.0, 15.0, whole=True),
    "throttle_filter_set_hz": Setting("PILOT_THR_FILT", 0.0, 0.0, 10.0),
    "yaw_rate_max_set_dps": Setting("ATC_RATE_Y_MAX", 0.0, 0.0, 1080.0),
    "yaw_acceleration_set_dps2": Setting("ATC_ACCEL_Y_MAX", 27_000.0, 0.0, 72_000.0, 0.01),
    "loiter_acceleration_set_mps2": Setting("LOIT_ACC_MAX", 500.0, 100.0, 981.0, 0.01),
    "loiter_brake_set_mps2": Setting("LOIT_BRK_ACCEL", 250.0, 25.0, 300.0, 0.01),
    "wind_set_mps": Setting("SIM_WIND_SPD", 0.0, 0.0),
    "gusts_set_mps": Setting("SIM_WIND_TURB", 0.0, 0.0),
    "landed_disarms_set": Setting("PILOT_THR_BHV", 0.0, 0.0, 7.0, whole=True),
    "fence_margin_set_m": Setting("FENCE_MARGIN", 2.0, 1.0, 10.0),
    "acro_yaw_rate_set_dps": Setting("ACRO_YAW_P", 4.5, 1.0, 10.0, 45.0),
    "fence_altitude_min_set_m": Setting("FENCE_ALT_MIN", -10.0, -100.0, 100.0),
    "fence_points_set": Setting("FENCE_TOTAL", 0.0, 0.0, whole=True),
    "fence_radius_set_m": Setting("FENCE_RADIUS", 300.0, 30.0, 10_000.0),
    "arming_checks_set": Setting("ARMING_CHECK", 1.0, whole=True),
    "variance_set": Setting("FS_EKF_THRESH", 0.8, 0.6, 1.0),
    "angle_max_set_deg": Setting("ANGLE_MAX", 3000.0, 1000.0, 8000.0, 0.01, whole=True),
    "waypoint_radius_set_m": Setting("WPNAV_RADIUS", 200.0, 5.0, 1000.0, 0.01),
    "acceleration_set_mps2": Setting("WPNAV_ACCEL", 250.0, 50.0, 500.0, 0.01),
    "pilot_takeoff_set_m": Setting("PILOT_TKOFF_ALT", 0.0, 0.0, 1000.0, 0.01),
    "pilot_acceleration_set_mps2": Setting("PILOT_ACCEL_Z", 250.0, 50.0, 500.0, 0.01, whole=True),
    "climb_acceleration_set_mps2": Setting("WPNAV_ACCEL_Z", 250.0, 50.0, 500.0, 0.01),
    "yaw_slew_set_dps": Setting("ATC_SLEW_YAW", 6000.0, 500.0, 18000.0, 0.01),
    "pilot_speed_down_set_mps": Setting("PILOT_SPEED_DN", 0.0, 0.0, 500.0, 0.01, whole=True),
    "cruise_speed_set_mps": Setting("WPNAV_SPEED", 1000.0, 20.0, 2000.0, 0.01),
    "return_speed_set_mps": Setting("RTL_SPEED", 0.0, 0.0, 2000.0, 0.01, whole=True),
    "return_wait_set_s": Setting("RTL_LOIT_TIME", 5000.0, 0.0, 60000.0, 0.001, whole=True),
    "return_climb_min_set_m": Setting("RTL_CLIMB_MIN", 0.0, 0.0, 3000.0, 0.01, whole=True),
    "loiter_speed_set_mps": Setting("LOIT_SPEED", 1250.0, 20.0, 3500.0, 0.01),
    "disarm_delay_set_s": Setting("DISARM_DELAY", 10.0, 0.0, 127.0, whole=True),
    "roll_rate_max_set_dps": Setting("ATC_RATE_R_MAX", 0.0, 0.0, 1080.0),
    "roll_acceleration_set_dps2": Setting("ATC_ACCEL_R_MAX", 110_000.0, 0.0, 180_000.0, 0.01),
    "gps_noise_set_m": Setting("SIM_GPS_NOISE", 0.0, 0.0),
    "hover_throttle_set": Setting("MOT_THST_HOVER", 0.35, 0.125, 0.6875),
    "pitch_rate_max_set_dps": Setting("ATC_RATE_P_MAX", 0.0, 0.0, 1080.0),
    "pitch_acceleration_set_dps2": Setting("ATC_ACCEL_P_MAX", 110_000.0, 0.0, 180_000.0, 0.01),
    "gps_forward_set_m": Setting("GPS_POS1_X", 0.0, -5.0, 5.0, kept=True),
    "gps_right_set_m": Setting("GPS_POS1_Y", 0.0, -5.0, 5.0, kept=True),
    "roll_stick_min_set_us": Setting("RC1_MIN", 1000.0, 800.0, 2200.0, whole=True),
    "roll_stick_max_set_us": Setting("RC1_MAX", 2000.0, 800.0, 2200.0, whole=True),
    "pitch_stick_min_set_us": Setting("RC2_MIN", 1000.0, 800.0, 2200.0, whole=True),
    "pitch_stick_max_set_us": Setting("RC2_MAX", 2000.0, 800.0, 2200.0, whole=True),
    "trim_roll_set_deg": Setting("AHRS_TRIM_X", 0.0, -0.1745, 0.1745, 57.29578),
    "trim_pitch_set_deg": Setting("AHRS_TRIM_Y", 0.0, -0.1745, 0.1745, 57.29578),
    "circle_rate_set_dps": Setting("CIRCLE_RATE", 20.0, -90.0, 90.0),
    "descent_speed_set_mps": Setting("WPNAV_SPEED_DN", 150.0, 10.0, 500.0, 0.01),
    "circle_radius_set_m": Setting("CIRCLE_RADIUS", 1000.0, 0.0, 200_000.0, 0.01),
}

ALSO_NAMED = {"radio_loss": "SIM_RC_FAIL", "gps_noise": "SIM_GPS_NOISE"}
"""Faults by a name of their own that stand for a setting, of the same values."""
SWITCHED_BY = {"FENCE_ENABLE": "DO_FENCE_ENABLE", "CHUTE_ENABLED": "DO_PARACHUTE"}
"""Commands that stand for a setting: without them a rule asks for a fence that was switched off."""

MODES_BY_COMMAND = {
    "NAV_LAND": "LAND",
    "NAV_RETURN_TO_LAUNCH": "RTL",
    "NAV_LOITER_UNLIM": "LOITER",
    "SOLO_BTN_FLY_CLICK": "LOITER",
    "SOLO_BTN_FLY_HOLD": "LAND",
    "SOLO_BTN_PAUSE_CLICK": "BRAKE",
}


_KEEPS_MODE = (
    *("CONDITION_YAW", "DO_CHANGE_SPEED", "DO_SET_HOME", "DO_SET_ROI", "DO_FENCE_ENABLE", "DO_SEND_BANNER"),
    *("DO_SET_SERVO", "DO_SET_RELAY", "DO_REPEAT_SERVO", "DO_REPEAT_RELAY", "COMPONENT_ARM_DISARM"),
    "SET_POSITION_TARGET_LOCAL_NED",
)
"""Commands after which no autopilot has a reason to leave its mode."""


LAST_MODE, UNUSED_MODES = 29, (8, 10, 12)
"""Numbers that are no flight mode of any ArduCopter since 3.2 (MAVLink: COPTER_MODE)."""


def may_change_mode(stimulus: Stimulus) -> bool:
    """Say whether a stick, mode or command may change the mode; DO_REPOSITION may where its second number says so.

    DO_SET_MODE may where its number is that of a mode.
    """
    if _is(stimulus, "DO_REPOSITION"):
        flags = _numbers(stimulus)[1]
        return not np.isfinite(flags) or int(flags) & 1 == 1
    if _is(stimulus, "DO_SET_MODE"):
        number = _numbers(stimulus)[1]
        return not np.isfinite(number) or (0 <= number <= LAST_MODE and int(number) not in UNUSED_MODES)
    if stimulus.kind == "command":
        return not stimulus.name.upper().endswith(_KEEPS_MODE)
    return stimulus.kind in ("mode", "stick")


def moves(stimulus: Stimulus) -> bool:
    """Say whether an input can move a vehicle, or what it believes of itself, by itself."""
    if stimulus.kind == "command":
        return not stimulus.name.upper().endswith(_STILL)
    if stimulus.kind in ("parameter", "sensor_fault"):
        shared = stimulus.kind == "sensor_fault" and not stimulus.name.lower().startswith(("sim_", "batt", "radio"))
        return shared or _MOVING.match(stimulus.name.lower()) is not None
    return True


def diverts(stimulus: Stimulus) -> bool:
    """Say whether a command may end the way to a place that was ordered, or move that place."""
    return stimulus.kind == "command" and not stimulus.name.upper().endswith(_ON_THE_WAY)


def stops_motors(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders the motors off without regard to flight."""
    values = _numbers(stimulus)
    if _is(stimulus, "DO_FLIGHTTERMINATION"):
        return values[0] > 0.5
    if _is(stimulus, "DO_AUX_FUNCTION"):
        return cuts_motors(stimulus) or _switched(stimulus) in DISARMS
    return _is(stimulus, "COMPONENT_ARM_DISARM") and values[0] < 0.5 and values[1] in FORCE


def cuts_motors(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders the motors to stand while the vehicle stays armed."""
    return _is(stimulus, "DO_AUX_FUNCTION") and _switched(stimulus) in CUTS


def _switched(stimulus: Stimulus) -> tuple[int, int] | None:
    """Return function and position of DO_AUX_FUNCTION as ArduPilot takes them, without their fractions."""
    values = _numbers(stimulus)[:2]
    return (int(values[0]), int(values[1])) if np.isfinite(values).all() else None


def asks_to_stop(stimulus: Stimulus) -> bool:
    """Say whether the stimulus asks for the motors off in the one way that MAVLink leaves no doubt about."""
    values = _numbers(stimulus)
    if _is(stimulus, "DO_FLIGHTTERMINATION"):
        return values[0] > 0.5
    return _is(stimulus, "COMPONENT_ARM_DISARM") and values[:2] == (0.0, FORCE[0])


def forces_arming(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders the motors on without checks.

    ArduCopter starts them, too, to learn what they do to the compass (the sixth number of PREFLIGHT_CALIBRATION), and
    to run one alone (DO_MOTOR_TEST).
    """
    values = _numbers(stimulus)
    if _is(stimulus, "DO_MOTOR_TEST"):
        return True
    if _is(stimulus, "PREFLIGHT_CALIBRATION"):
        return values[5] == 1.0
    return _is(stimulus, "COMPONENT_ARM_DISARM") and values[0] == 1.0 and values[1] in FORCE


def releases(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders the parachute out."""
    return _is(stimulus, "DO_PARACHUTE") and _numbers(stimulus)[0] == 2.0


def sets_climb(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders how fast to climb or sink (SPEED_TYPE 2 or 3)."""
    return _is(stimulus, "DO_CHANGE_SPEED") and _numbers(stimulus)[0] in (2.0, 3.0)


def sets_height(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders a height: a take-off, which PX4 obeys in the air, too, or a place with the flag.

    The flag of DO_REPOSITION asks for the mode that flies there; without it who holds its place is to stay.
    """
    by_place = _is(stimulus, "DO_REPOSITION") and may_change_mode(stimulus)
    return by_place or _is(stimulus, "NAV_TAKEOFF") or _is(stimulus, "DO_CHANGE_ALTITUDE")


def starts_mission(stimulus: Stimulus) -> bool:
    """Say whether the stimulus orders a mission to begin anew."""
    return _is(stimulus, "MISSION_START")


def mode_ordered(stimulus: Stimulus) -> int | None:
    """Return the number of the mode that a stimulus orders, None if it orders none that has a name here."""
    if stimulus.kind == "mode":
        return MODES.get(stimulus.name.upper())
    if _is(stimulus, "DO_SET_MODE"):
        values = _numbers(stimulus)
        known = int(values[0]) & 1 == 1 and values[1] in MODES.values() if np.isfinite(values[:2]).all() else False
        return int(values[1]) if known else None
    by_command = (mode for command, mode in MODES_BY_COMMAND.items() if _is(stimulus, command))
    return next((MODES[mode] for mode in by_command), None)


def moves_home(stimulus: Stimulus) -> bool:
    """Say whether the stimulus gives another place as home."""
    return _is(stimulus, "DO_SET_HOME")


def _is(stimulus: Stimulus, command: str) -> bool:
    return stimulus.kind == "command" and stimulus.name.upper().endswith(command)


def _numbers(stimulus: Stimulus) -> tuple[float, ...]:
    return (*stimulus.values, *(0.0,) * 7)[:7]


def setting_over_time(name: str, test_case: TestCase, given: Sequence[Given], times: Array) -> Array:
    """Return a setting in force in SI units, shape (moments,): as the target starts, then as stimuli change it.

    Where it is not known whether a value was taken, one out of range is held to be refused.
    """
    row = SETTINGS[name]
    usual = default_settings(test_case.target.name).get(row.parameter, row.default)
    changes = [
        (stimulus.at_s, stimulus.values[0])
        for stimulus, answer, _ in given
        if stimulus.values
        and (_names(stimulus, row.parameter) or _switches(stimulus, row.parameter))
        and (answer != "unanswered" or row.low <= stimulus.values[0] <= row.high)
    ]
    held = set_last(changes, np.full(len(times), test_case.target.parameters.get(row.parameter, usual)), times)
    if row.kept:
        held = np.maximum.accumulate(np.abs(held))
    return (np.trunc(held + np.copysign(ROUNDED_UP, held)) if row.whole else held) * row.unit


def _names(stimulus: Stimulus, parameter: str) -> bool:
    return ALSO_NAMED.get(stimulus.name, stimulus.name) == parameter


def _switches(stimulus: Stimulus, parameter: str) -> bool:
    """Say whether a command switches a setting off (0) or on (1); MAVLink has other numbers mean other things."""
    command = SWITCHED_BY.get(parameter)
    return command is not None and _is(stimulus, command) and stimulus.values[0] in (0.0, 1.0)


def speed_ordered(given: Sequence[Given], usual_mps: Array, times: Array) -> Array:
    """Return the speed of autonomous modes, shape (moments,): as set, or as DO_CHANGE_SPEED last ordered it."""
    told = ((one.at_s, _numbers(one)[1]) for one, _, _ in given if _is(one, "DO_CHANGE_SPEED"))
    return set_last([(at_s, speed_mps) for at_s, speed_mps in told if speed_mps >= SPEED_LEAST_MPS], usual_mps, times)


class Place(NamedTuple):
    """An order to go to a place, metres from the origin of the track, height above home."""

    at_s: float
    x_m: float
    y_m: float
    altitude_m: float


def places(test_case: TestCase, given: Sequence[Given]) -> list[Place]:
    """Return the orders to go somewhere (DO_REPOSITION); NaN where the origin of the track is not known."""
    origin = origin_of(test_case)
    found = []
    for stimulus, _, _ in given:
        if _is(stimulus, "DO_REPOSITION"):
            values = _numbers(stimulus)
            x_m, y_m = to_local(values[4], values[5], *origin) if origin else (np.nan, np.nan)
            found.append(Place(stimulus.at_s, x_m, y_m, values[6]))
    return found


def origin_of(test_case: TestCase) -> tuple[float, float] | None:
    """Return latitude and longitude at which the track of a flight begins, degrees; None where that is not known."""
    mission = test_case.scenario.mission
    if mission is not None:
        return mission.home_lat_deg, mission.home_lon_deg
    return (HOME_LAT_DEG, HOME_LON_DEG) if test_case.target.name == DEFAULT_TARGET else None


def home_off(
    test_case: TestCase, given: Sequence[Given], track: tuple[NDArray[Any], NDArray[Any], NDArray[Any]], times: Array
) -> NDArray[np.float64]:
    """Return the distance in the plane to the home that was made last, shape (moments,); NaN where it is not known.

    Home is where the track begins, then where the motors are started, then what DO_SET_HOME makes it: the place at hand
    with 1 as its first number, else the place given.

    Args:
        track: position north and east in metres, 1 while armed, shape (moments,) each.
    """
    x_m, y_m, armed = track
    origin = origin_of(test_case)
    made: list[tuple[float, int | None, tuple[float, ...]]] = [
        (float(times[at]), int(at), ()) for at in np.flatnonzero((armed[1:] > 0) & (armed[:-1] == 0)) + 1
    ]
    made += [(one.at_s, None, _numbers(one)) for one, _, _ in given if moves_home(one)]
    begins_s, homes = [-np.inf], [(0.0, 0.0) if origin else (np.nan, np.nan)]
    for at_s, at, values in sorted(made, key=lambda one: one[0]):
        if at is None and values[0] != 1.0:
            place = to_local(values[4], values[5], *origin) if origin else (np.nan, np.nan)
        else:
            here = _index(times, at_s) if at is None else at
            place = float(x_m[here]), float(y_m[here])
        begins_s.append(at_s - 1e-9)
        homes.append(place)
    north_m, east_m = np.array(homes, dtype=x_m.dtype)[np.searchsorted(begins_s, times, side="right") - 1].T
    return np.asarray(np.hypot(x_m - north_m, y_m - east_m), dtype=np.float64)


def _index(times: Array, at_s: float) -> int:
    return min(int(np.searchsorted(times, at_s)), len(times) - 1)


def paused(given: Sequence[Given], times: Array) -> Array:
    """Return the time since the last order to pause that no order to go on followed, shape (moments,)."""
    told = [
        (one.at_s - 1e-9, one.at_s if _numbers(one)[0] == 0.0 else -NEVER_S)
        for one, _, _ in given
        if _is(one, "DO_PAUSE_CONTINUE")
    ]
    return np.asarray(times - set_last(told, np.full(len(times), -NEVER_S), times))


def since(at_s: Sequence[float], times: Array, never_s: float = 0.0) -> Array:
    """Return the time since the last of some moments, shape (moments,); counted from `never_s` before the first."""
    at = np.array([never_s, *at_s])
    return np.asarray(times - at[np.searchsorted(at, times + 1e-9, side="right") - 1])


def held(orders: Sequence[tuple[float, float]], times: Array) -> Array:
    """Return the value ordered last at each moment, 0 before the first, shape (moments,)."""
    values = np.array([0.0, *(value for _, value in orders)])
    at = np.array([at_s for at_s, _ in orders])
    return np.asarray(values[np.searchsorted(at, times + 1e-9, side="right")])
