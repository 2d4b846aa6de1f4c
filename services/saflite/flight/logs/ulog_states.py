"""What PX4 logs of failsafes, link, ground and termination, as signals.

Newer releases log `failsafe_flags` (1.14 and later), older ones `vehicle_status_flags` (up to 1.12 with `condition_`
before its names); both say of each state whether it is lost or valid.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import pairwise

import numpy as np

from saflite.contract.signals import MODES
from saflite.flight.logs.flight_log import add_taken_off
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.settings import Made, add_settings
from saflite.flight.logs.topics import Topics, field, held, times

SOURCES: dict[str, str] = {
    **dict.fromkeys(("landed", "taken_off"), "vehicle_land_detected"),
    "failsafe_gps": "failsafe_flags.local_position_invalid or vehicle_status_flags.local_position_valid",
    "failsafe_radio": "failsafe_flags.manual_control_signal_lost or vehicle_status.rc_signal_lost",
    "rc_present": "failsafe_flags.manual_control_signal_lost or vehicle_status.rc_signal_lost",
    "failsafe_battery": "battery_status.warning",
    "failsafe_fence": "failsafe_flags.geofence_breached, geofence_result or vehicle_status.geofence_violated",
    "position_aided": "estimator_status_flags, estimator_status, or parameters EKF2_GPS_CTRL or EKF2_AID_MASK",
    "baro_altitude_m": "vehicle_air_data",
    "baro_ok": "vehicle_air_data",
    "stop_ordered": "actuator_armed or vehicle_command",
    "chute_released": "vehicle_control_mode.flag_control_termination_enabled or actuator_armed.force_failsafe",
    "circle_radius_m": "orbit_status",
    "circle_rate_dps": "no message: the rate of an orbit is not logged",
}
_NO_TERMINATION = 121212  # CBRK_FLIGHTTERM: the circuit breaker that forbids termination
_WARNING_LOW = 1  # battery_status.BATTERY_WARNING_LOW
_ONLY_TELLS = {0.0, 1.0}  # GF_ACTION: nothing, a warning
_AIDS = ("cs_opt_flow", "cs_ev_pos", "cs_ev_vel", "cs_aux_gpos")  # of estimator_status_flags
_AID_BITS = 1 << 3 | 1 << 12 | 1 << 24  # the same in estimator_status.control_mode_flags
_KILLS = ("kill", "manual_lockdown", "termination", "force_failsafe", "lockdown")

# signal: where it may stand (topic, field, value that makes it 1), the newest first
_FLAGS: dict[str, tuple[tuple[str, str, int], ...]] = {
    "failsafe_gps": (
        ("failsafe_flags", "local_position_invalid", 1),
        ("vehicle_status_flags", "local_position_valid", 0),
        ("vehicle_status_flags", "condition_local_position_valid", 0),
    ),
    "rc_present": (
        ("failsafe_flags", "manual_control_signal_lost", 0),
        ("vehicle_status", "rc_signal_lost", 0),
        ("vehicle_status_flags", "rc_signal_lost", 0),
    ),
    "failsafe_fence": (
        ("failsafe_flags", "geofence_breached", 1),
        ("geofence_result", "primary_geofence_breached", 1),
        ("geofence_result", "geofence_violated", 1),
        ("vehicle_status", "geofence_violated", 1),
        ("vehicle_status_flags", "geofence_violated", 1),
    ),
}


def add(topics: Topics, columns: Columns) -> None:
    """Add failsafes, link, barometer and orders to stop; parameters are told apart (`settings.py`)."""
    for signal, places in _FLAGS.items():
        found = ((field(topics, name, told), raised) for name, told, raised in places)
        flag = next(((column, raised) for column, raised in found if column is not None), None)
        if flag is not None:
            (at_s, values), raised = flag
            columns.hold(signal, at_s, (values > 0) == bool(raised))
    _lost(columns)
    _radio(topics, columns)
    warning = field(topics, "battery_status", "warning")
    if warning is not None:
        columns.hold("failsafe_battery", warning[0], warning[1] >= _WARNING_LOW)
    height = field(topics, "vehicle_air_data", "baro_alt_meter")
    if height is not None:
        columns.add("baro_altitude_m", *height)
        columns.hold("baro_ok", height[0], 1.0)
    _stops(topics, columns)
    _orbit(topics, columns)
    add_taken_off(columns)


def add_parachute(topics: Topics, parameters: Mapping[str, float], columns: Columns) -> None:
    """Add `chute_released`: PX4 gives a parachute to flight termination, which a circuit breaker may forbid."""
    if parameters.get("CBRK_FLIGHTTERM") == _NO_TERMINATION:
        columns.hold("chute_released", [0.0], [0.0])
        return
    ended = field(topics, "vehicle_control_mode", "flag_control_termination_enabled")
    ended = ended or field(topics, "actuator_armed", "force_failsafe")
    if ended is not None:
        columns.hold("chute_released", *ended)


def add_fence_that_never_acts(
    parameters: Mapping[str, float], changes: Iterable[tuple[float, str, float]], columns: Columns
) -> None:
    """Add `failsafe_fence` where no message tells of a breach and nothing is set to come of one (GF_ACTION)."""
    actions = {parameters.get("GF_ACTION"), *(value for _, name, value in changes if name == "GF_ACTION")}
    if "failsafe_fence" not in columns and actions <= _ONLY_TELLS:
        columns.hold("failsafe_fence", [0.0], [0.0])


def add_position_aided(
    topics: Topics, parameters: Mapping[str, float], changes: list[tuple[float, str, float]], columns: Columns
) -> None:
    """Add `position_aided`: by what the estimator says it fuses, where it does not by what its parameters allow it."""
    flags = [column for name in _AIDS if (column := field(topics, "estimator_status_flags", name)) is not None]
    bits = field(topics, "estimator_status", "control_mode_flags")
    if flags:
        columns.hold("position_aided", flags[0][0], np.max([values for _, values in flags], axis=0) > 0)
    elif bits is not None:
        columns.hold("position_aided", bits[0], (bits[1].astype(np.int64) & _AID_BITS) > 0)
    else:
        add_settings(columns, {"position_aided": Made("", _may_be_aided)}, parameters, changes)


def _may_be_aided(given: Mapping[str, float]) -> float:
    """1 without satellites, 0 with them alone; not known where something else may be fused beside."""
    if "EKF2_GPS_CTRL" in given:  # 1.14 and later; bits of position and speed
        satellites = int(given["EKF2_GPS_CTRL"]) & 0b101
        others = int(given.get("EKF2_OF_CTRL", 1)) | int(given.get("EKF2_EV_CTRL", 0)) & 0b101
    else:  # bits: satellites, optical flow, position and speed of vision
        satellites, others = (int(given["EKF2_AID_MASK"]) & bits for bits in (1, 2 | 8 | 256))
    return 1.0 if not satellites else math.nan if others else 0.0


def _lost(columns: Columns) -> None:
    """A position that never was there is not lost: the failsafe counts once it was valid."""
    invalid = columns.get("failsafe_gps")
    if invalid is not None:
        at_s, values = invalid
        columns.hold("failsafe_gps", at_s, values * np.maximum.accumulate(1.0 - values))


def _radio(topics: Topics, columns: Columns) -> None:
    """Raised while the link is lost and the vehicle is in a failsafe; a link that is not asked for raises none."""
    present, failsafe = columns.get("rc_present"), field(topics, "vehicle_status", "failsafe")
    if present is None or failsafe is None:
        return
    at_s = np.union1d(present[0], failsafe[0])
    columns.hold("failsafe_radio", at_s, (1.0 - held(present, at_s)) * held(failsafe, at_s))


def _stops(topics: Topics, columns: Columns) -> None:
    """Add `stop_ordered`: an order to stop the motors counts until they are armed again; commands are told apart.

    A flag that is up as they are armed is no order: in simulation (HITL) PX4 keeps the outputs locked throughout.
    """
    if "actuator_armed" not in topics:
        return
    at_s, armed = times(topics["actuator_armed"]), columns.get("armed")
    orders = [order for name in _KILLS if (order := field(topics, "actuator_armed", name)) is not None]
    begins_s = armed[0][1:][np.diff(armed[1]) > 0] if armed is not None else np.zeros(0)
    edges = [0, *np.searchsorted(at_s, begins_s).tolist(), len(at_s)]
    stopped = np.zeros(len(at_s))
    for start, end in pairwise(edges):
        for _, values in orders:
            flags = values[start:end] > 0
            raised = flags & np.logical_or.accumulate(~flags)  # from the first time on at which it was down
            stopped[start:end] = np.maximum(stopped[start:end], np.logical_or.accumulate(raised))
    columns.hold("stop_ordered", at_s, stopped)


def _orbit(topics: Topics, columns: Columns) -> None:
    """Add the radius of an orbit, 0 in other modes; the rate only where there was none."""
    mode, radius = columns.get("mode"), field(topics, "orbit_status", "radius")
    if radius is not None:
        columns.hold("circle_radius_m", radius[0], np.abs(radius[1]))
    if mode is None or (mode[1] == MODES["CIRCLE"]).any():
        return
    for signal in ("circle_radius_m", "circle_rate_dps"):
        columns.hold(signal, [0.0], [0.0])
