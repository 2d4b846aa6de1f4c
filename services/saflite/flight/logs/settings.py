"""Parameters of real autopilots as the settings that policies read, in SI units.

Sources: the parameter references of ArduCopter (3.2 to 4.7) and PX4 (1.11 to 1.16). Where a release renamed a parameter
both names stand, the newer one first. What an autopilot has no parameter for is left out: such a setting is not known.
Nor is one whose parameter has a value that means nothing here: it is NaN, from which no rule can tell anything.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from saflite.flight.logs.flight_log import Points
from saflite.flight.logs.resample import Columns

Parameters = Mapping[str, float]
Rule = Callable[[Parameters], float]


class Plain(NamedTuple):
    """A setting that is one parameter, times the size of its unit."""

    names: tuple[str, ...]
    unit: float = 1.0

    def __call__(self, parameters: Parameters) -> float:
        """Return the setting; raises StopIteration where no name of it is known."""
        return parameters[next(name for name in self.names if name in parameters)] * self.unit


class Made(NamedTuple):
    """A setting that is worked out, NaN where a value has no meaning; `words` names the parameters it needs."""

    words: str
    rule: Rule

    def __call__(self, parameters: Parameters) -> float:
        """Return the setting; raises KeyError or StopIteration where a parameter is not known."""
        return self.rule(parameters)


def _of(*names: str, unit: float = 1.0) -> Plain:
    return Plain(names, unit)


def _codes(meanings: Mapping[str, Mapping[float, float]]) -> Made:
    """A setting by the first of these parameters that is known, and what its values mean."""
    return Made(" or ".join(meanings), lambda given: _meant(meanings, given))


def _meant(meanings: Mapping[str, Mapping[float, float]], given: Parameters) -> float:
    name = next(name for name in meanings if name in given)
    return float(meanings[name].get(given[name], math.nan))


def _instead_of_0(first: Made, second: Made) -> Made:
    return Made(f"{first.words} or {second.words}", lambda given: first(given) or second(given))


_CM = 0.01


_BY_SOURCE = {1.0: 0.0, 2.0: 1.0, 3.0: 2.0}
_BY_EKF2: dict[str, Mapping[float, float]] = {"EK2_ALT_SOURCE": {0.0: 0.0, 1.0: 1.0, 2.0: 2.0}}


SOURCE_SET = "EK3_SRC_SET"
"""Stands for the set of sources that was switched to last, 1 to 3: ArduPilot has events for it, not a parameter."""
_SATELLITES, _NONE = 3.0, 0.0  # EK3_SRC1_POSXY, EK3_SRC1_VELXY
_NO_SATELLITES = 3.0  # EK2_GPS_TYPE and, up to 4.0, EK3_GPS_TYPE


def _ardupilot_height(given: Parameters) -> float:
    """Go by the filter that flies, where settings of both are known; the other one's mean nothing then.

    Up to 3.3 what flew without a filter went by the barometer.
    """
    if given.get("AHRS_EKF_USE") == 0.0 and "AHRS_EKF_TYPE" not in given:
        return 0.0
    source = f"EK3_SRC{given.get(SOURCE_SET, 1.0):.0f}_POSZ"
    by_ekf3: dict[str, Mapping[float, float]] = {source: _BY_SOURCE, "EK3_ALT_SOURCE": {0.0: 0.0, 1.0: 1.0, 2.0: 2.0}}
    flies = {**_BY_EKF2, **by_ekf3} if given.get("AHRS_EKF_TYPE") == 2.0 else {**by_ekf3, **_BY_EKF2}
    return _meant(flies, given)


def _ardupilot_aided(given: Parameters) -> float:
    """Go by the sources of the filter, up to 4.0 by what is fitted beside the receiver."""
    source = f"EK3_SRC{given.get(SOURCE_SET, 1.0):.0f}_"
    if f"{source}POSXY" in given and given.get("AHRS_EKF_TYPE") != 2.0:
        place, speed = given[f"{source}POSXY"], given.get(f"{source}VELXY", _SATELLITES)
        return float(place != _SATELLITES or speed not in (_NONE, _SATELLITES))
    use = next(given[name] for name in ("EK2_GPS_TYPE", "EK3_GPS_TYPE") if name in given)
    fitted = max(given.get(name, 0.0) for name in ("FLOW_TYPE", "VISO_TYPE", "BCN_TYPE"))
    return float(use == _NO_SATELLITES or fitted > 0.0)


def _ardupilot_ceiling(given: Parameters) -> float:
    kinds = given.get("FENCE_TYPE", 7.0)
    return float(given["FENCE_ENABLE"] > 0 and int(kinds) & 1 > 0) if math.isfinite(kinds) else math.nan


def _si(name: str, *older: str) -> Made:
    """A setting that is in SI units from 4.7 on, in hundredths of them under its older names."""
    before = _of(*older, unit=_CM)
    return Made(" or ".join((name, *older)), lambda given: given[name] if name in given else before(given))


_RETURN, _LAND = _si("RTL_ALT_M", "RTL_ALT"), _si("LAND_SPD_MS", "LAND_SPEED")
_CRUISE, _DESCENT = _si("WP_SPD", "WPNAV_SPEED"), _si("WP_SPD_DN", "WPNAV_SPEED_DN")
_PILOT_UP = _si("PILOT_SPD_UP", "PILOT_SPEED_UP", "PILOT_VELZ_MAX")
_ALL_CHECKS, _SKIPS_ALL = 1.0, -1.0  # ARMING_CHECK, ARMING_SKIPCHK


def _ardupilot_return(given: Parameters) -> float:
    """Not known where it counts from a terrain that no log tells."""
    return math.nan if given.get("RTL_ALT_TYPE") == 1.0 else _RETURN(given)


def _ardupilot_land(given: Parameters) -> float:
    """Not known where precision landing is on: it waits for its target, tries again, and slows down over it."""
    return math.nan if given.get("PLND_ENABLED") == 1.0 else _LAND(given)


def _ardupilot_checks(given: Parameters) -> float:
    """Go by the checks that are made (up to 4.6), or by those that are skipped: which are left is not known then."""
    if "ARMING_CHECK" in given:
        return given["ARMING_CHECK"]
    return {0.0: _ALL_CHECKS, _SKIPS_ALL: 0.0}.get(given["ARMING_SKIPCHK"], math.nan)


def _once_10_s(given: Parameters) -> float:
    """Up to 3.5 a voltage had to be low for 10 s, which was no parameter."""
    return given["BATT_LOW_TIMER"] if "BATT_LOW_TIMER" in given else 10.0 + 0.0 * given["FS_BATT_VOLTAGE"]


def _critical(given: Parameters) -> float:
    """Up to 3.5 there was one limit alone."""
    return given["BATT_CRT_VOLT"] if "BATT_CRT_VOLT" in given else 0.0 * given["FS_BATT_VOLTAGE"]


ARDUPILOT: dict[str, Plain | Made] = {
    "rtl_altitude_set_m": Made(f"{_RETURN.words} with RTL_ALT_TYPE", _ardupilot_return),
    "rtl_altitude_final_set_m": _si("RTL_ALT_FINAL_M", "RTL_ALT_FINAL"),
    "return_wait_set_s": _of("RTL_LOIT_TIME", unit=0.001),
    "pilot_takeoff_set_m": _si("PILOT_TKO_ALT_M", "PILOT_TKOFF_ALT"),
    "yaw_slew_set_dps": _si("ATC_RATE_WPY_MAX", "ATC_SLEW_YAW"),
    "return_climb_min_set_m": _si("RTL_CLIMB_MIN_M", "RTL_CLIMB_MIN"),
    "return_speed_set_mps": _instead_of_0(_si("RTL_SPEED_MS", "RTL_SPEED"), _CRUISE),
    "cruise_speed_set_mps": _CRUISE,
    "loiter_speed_set_mps": _si("LOIT_SPEED_MS", "LOIT_SPEED", "WPNAV_LOIT_SPEED"),
    "land_speed_set_mps": Made(f"{_LAND.words} with PLND_ENABLED", _ardupilot_land),
    "land_speed_high_set_mps": _instead_of_0(_si("LAND_SPD_HIGH_MS", "LAND_SPEED_HIGH"), _DESCENT),
    "land_altitude_low_set_m": _si("LAND_ALT_LOW_M", "LAND_ALT_LOW"),
    "pilot_speed_up_set_mps": _PILOT_UP,
    "pilot_speed_down_set_mps": _instead_of_0(_si("PILOT_SPD_DN", "PILOT_SPEED_DN", "PILOT_VELZ_MAX"), _PILOT_UP),
    "takeoff_speed_set_mps": _si("WP_SPD_UP", "WPNAV_SPEED_UP"),
    "chute_altitude_min_set_m": _of("CHUTE_ALT_MIN"),
    "fs_throttle_set_pwm": _of("FS_THR_VALUE"),
    "fs_throttle_enabled": _of("FS_THR_ENABLE"),
    "failsafe_options_set": _of("FS_OPTIONS"),
    "circle_options_set": _of("CIRCLE_OPTIONS"),
    "auto_options_set": _of("AUTO_OPTIONS"),
    "pilot_turn_speed_set_dps": _of("PILOT_Y_RATE"),
    "fs_gps_action": _of("FS_EKF_ACTION"),
    "fs_gps_delay_set_s": Made("FS_EKF_ACTION", lambda given: 0.0 * given["FS_EKF_ACTION"]),  # there is no delay to set
    "fence_enabled": Made("FENCE_ENABLE and FENCE_TYPE", _ardupilot_ceiling),
    "fence_on_set": _of("FENCE_ENABLE"),
    "fence_type_set": _of("FENCE_TYPE"),
    "fence_action_set": _of("FENCE_ACTION"),
    "fence_altitude_max_set_m": _of("FENCE_ALT_MAX"),
    "fence_altitude_min_set_m": _of("FENCE_ALT_MIN"),
    "fence_points_set": _of("FENCE_TOTAL"),
    "fence_radius_set_m": _of("FENCE_RADIUS"),
    "battery_low_set_v": _of("BATT_LOW_VOLT", "FS_BATT_VOLTAGE"),
    "battery_critical_set_v": Made("BATT_CRT_VOLT or FS_BATT_VOLTAGE", _critical),
    "battery_timer_set_s": Made("BATT_LOW_TIMER or FS_BATT_VOLTAGE", _once_10_s),
    "battery_low_action_set": _of("BATT_FS_LOW_ACT", "FS_BATT_ENABLE"),
    "battery_low_charge_set_mah": _of("BATT_LOW_MAH", "FS_BATT_MAH"),
    "battery_capacity_set_mah": _of("BATT_CAPACITY"),
    "arming_checks_set": Made("ARMING_CHECK or ARMING_SKIPCHK", _ardupilot_checks),
    "angle_max_set_deg": _si("ATC_ANGLE_MAX", "ANGLE_MAX"),
    "acceleration_set_mps2": _si("WP_ACC", "WPNAV_ACCEL"),
    "waypoint_radius_set_m": _si("WP_RADIUS_M", "WPNAV_RADIUS"),
    "disarm_delay_set_s": _of("DISARM_DELAY"),
    "trim_roll_set_deg": _of("AHRS_TRIM_X", unit=57.29578),
    "trim_pitch_set_deg": _of("AHRS_TRIM_Y", unit=57.29578),
    "circle_rate_set_dps": _of("CIRCLE_RATE"),
    "descent_speed_set_mps": _DESCENT,
    "circle_radius_set_m": _si("CIRCLE_RADIUS_M", "CIRCLE_RADIUS"),
    "altitude_source": Made("EK3_SRC1_POSZ or EK3_ALT_SOURCE or EK2_ALT_SOURCE or AHRS_EKF_USE", _ardupilot_height),
    "position_aided": Made("EK3_SRC1_POSXY or EK3_GPS_TYPE or EK2_GPS_TYPE", _ardupilot_aided),
}


_PX4_HEIGHTS = {0.0: 0.0, 1.0: 2.0, 2.0: 1.0, 3.0: 3.0}


def _px4_fence(given: Parameters) -> float:
    return float((given["GF_MAX_VER_DIST"] > 0) + 2 * (given["GF_MAX_HOR_DIST"] > 0))


def _px4_descend(given: Parameters) -> float:
    """Not known where precision landing is on: it may climb and wait for its target above home."""
    return math.nan if given.get("RTL_PLD_MD", 0.0) > 0.0 else given["RTL_DESCEND_ALT"]


PX4: dict[str, Plain | Made] = {
    "rtl_altitude_set_m": _of("RTL_RETURN_ALT"),
    "rtl_descend_altitude_set_m": Made("RTL_DESCEND_ALT with RTL_PLD_MD", _px4_descend),
    "rtl_altitude_final_set_m": Made(
        "RTL_LAND_DELAY and RTL_DESCEND_ALT",
        lambda given: given["RTL_DESCEND_ALT"] if given["RTL_LAND_DELAY"] < 0 else 0.0,
    ),
    "hold_altitude_min_set_m": _of("MIS_LTRMIN_ALT", "NAV_MIN_LTR_ALT"),
    "takeoff_altitude_set_m": _of("MIS_TAKEOFF_ALT"),
    "takeoff_slow_set_m": _of("MPC_LAND_ALT1"),
    "takeoff_speed_set_mps": _of("MPC_TKO_SPEED"),
    "land_speed_set_mps": _of("MPC_LAND_SPEED"),
    "land_speed_high_set_mps": _of("MPC_Z_V_AUTO_DN", "MPC_Z_VEL_MAX_DN"),
    "land_altitude_low_set_m": _of("MPC_LAND_ALT2"),
    "trim_roll_set_deg": _of("SENS_BOARD_X_OFF"),
    "trim_pitch_set_deg": _of("SENS_BOARD_Y_OFF"),
    "descent_speed_set_mps": _of("MPC_Z_V_AUTO_DN", "MPC_Z_VEL_MAX_DN"),
    "pilot_speed_up_set_mps": _of("MPC_Z_VEL_MAX_UP"),
    "pilot_speed_down_set_mps": _of("MPC_Z_VEL_MAX_DN"),
    "cruise_speed_set_mps": _of("MPC_XY_CRUISE"),
    "return_speed_set_mps": _of("MPC_XY_CRUISE"),
    "loiter_speed_set_mps": _of("MPC_VEL_MANUAL"),
    "angle_max_set_deg": Made(
        "MPC_TILTMAX_AIR and MPC_MAN_TILT_MAX", lambda given: max(given["MPC_TILTMAX_AIR"], given["MPC_MAN_TILT_MAX"])
    ),
    "acceleration_set_mps2": _of("MPC_ACC_HOR"),
    "disarm_delay_set_s": Made("COM_DISARM_LAND", lambda given: max(given["COM_DISARM_LAND"], 0.0)),
    "fence_enabled": Made(
        "GF_ACTION and GF_MAX_VER_DIST", lambda given: float(given["GF_ACTION"] > 0 and given["GF_MAX_VER_DIST"] > 0)
    ),
    "fence_on_set": Made("GF_ACTION", lambda given: float(given["GF_ACTION"] > 0)),
    "fence_type_set": Made("GF_MAX_VER_DIST and GF_MAX_HOR_DIST", _px4_fence),
    "fence_action_set": _codes({"GF_ACTION": {0: 0, 1: 0, 2: 4, 3: 1, 5: 2}}),
    "fs_action_delay_set_s": _of("COM_FAIL_ACT_T"),
    "fence_altitude_max_set_m": _of("GF_MAX_VER_DIST"),
    "fence_radius_set_m": _of("GF_MAX_HOR_DIST"),
    "fs_gps_action": _codes({"COM_POSCTL_NAVL": {0: 2, 1: 1}}),
    "fs_gps_delay_set_s": _of("COM_POS_FS_DELAY"),
    "arming_checks_set": Made("COM_ARM_WO_GPS", lambda given: float(given["COM_ARM_WO_GPS"] == 0)),
    "altitude_source": _codes({"EKF2_HGT_REF": _PX4_HEIGHTS, "EKF2_HGT_MODE": _PX4_HEIGHTS}),
}


def sources(table: Mapping[str, Plain | Made]) -> dict[str, str]:
    """Return by setting the parameters it is read from, in words."""
    return {
        name: f"parameter {' or '.join(row.names) if isinstance(row, Plain) else row.words}"
        for name, row in table.items()
    }


def add_settings(
    columns: Columns,
    table: Mapping[str, Plain | Made],
    initial: Parameters,
    changes: list[tuple[float, str, float]],
) -> None:
    """Add the settings in force: those of the beginning, and each change at its time (seconds)."""
    held = dict(initial)
    points: dict[str, Points] = {}
    for at_s, name, value in [(0.0, "", 0.0), *sorted(changes)]:
        if name:
            held[name] = value
        for signal, row in table.items():
            try:
                found = row(held)
            except (KeyError, StopIteration):  # another release has it under another name, or not at all
                continue
            known = points.setdefault(signal, [])
            if not known or known[-1][1] != found:
                known.append((at_s, found))
    for signal, course in points.items():
        columns.hold(signal, *zip(*course, strict=True))
