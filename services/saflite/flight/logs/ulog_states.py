"""What PX4 logs of failsafes, link, ground and termination, as signals.

Newer releases log `failsafe_flags` (1.14 and later), older ones `vehicle_status_flags` (up to 1.12 with `condition_`
before its names); both say of each state whether it is lost or valid.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from saflite.contract.signals import MODES
from saflite.flight.logs.flight_log import add_taken_off
from saflite.flight.logs.resample import Columns

Topic = Mapping[str, Any]
Topics = Mapping[str, Topic]
SOURCES: dict[str, str] = {
    **dict.fromkeys(("landed", "taken_off"), "vehicle_land_detected"),
    "failsafe_gps": "failsafe_flags.local_position_invalid or vehicle_status_flags.local_position_valid",
    "failsafe_radio": "failsafe_flags.manual_control_signal_lost or vehicle_status.rc_signal_lost",
    "rc_present": "failsafe_flags.manual_control_signal_lost or vehicle_status.rc_signal_lost",
    "failsafe_battery": "battery_status.warning",
    "failsafe_fence": "failsafe_flags.geofence_breached or geofence_result",
    "baro_altitude_m": "vehicle_air_data",
    "baro_ok": "vehicle_air_data",
    "chute_released": "vehicle_control_mode.flag_control_termination_enabled or actuator_armed.force_failsafe",
    "crashed": "no message: PX4 does not say that it crashed",
    "circle_radius_m": "orbit_status",
    "circle_rate_dps": "no message: the rate of an orbit is not logged",
}
_NO_TERMINATION = 121212  # CBRK_FLIGHTTERM: the circuit breaker that forbids termination
_WARNING_LOW = 1  # battery_status.BATTERY_WARNING_LOW
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
        ("vehicle_status_flags", "geofence_violated", 1),
    ),
}


def add(topics: Topics, columns: Columns) -> None:
    """Add failsafes, link, barometer and orders to stop; parameters are told apart (`settings.py`)."""
    for signal, places in _FLAGS.items():
        for name, field, raised in places:
            if name in topics and field in topics[name]:
                columns.hold(signal, _times(topics[name]), np.asarray(topics[name][field]).astype(bool) == bool(raised))
                break
    _lost(columns)
    _radio(topics, columns)
    battery = topics.get("battery_status")
    if battery is not None and "warning" in battery:
        columns.hold("failsafe_battery", _times(battery), np.asarray(battery["warning"]) >= _WARNING_LOW)
    air = topics.get("vehicle_air_data")
    if air is not None and "baro_alt_meter" in air:
        columns.add("baro_altitude_m", _times(air), air["baro_alt_meter"])
        columns.hold("baro_ok", _times(air), 1.0)
    armed = topics.get("actuator_armed")
    if armed is not None:
        ordered = np.zeros(len(armed["timestamp"]))
        for field in _KILLS:
            ordered = np.maximum(ordered, np.asarray(armed[field], dtype=np.float64) if field in armed else 0.0)
        columns.hold("stop_ordered", _times(armed), np.maximum.accumulate(ordered))
    _orbit(topics, columns)
    add_taken_off(columns)


def add_parachute(topics: Topics, parameters: Mapping[str, float], columns: Columns) -> None:
    """Add `chute_released`: PX4 gives a parachute to flight termination, which a circuit breaker may forbid."""
    mode, armed = topics.get("vehicle_control_mode"), topics.get("actuator_armed")
    if parameters.get("CBRK_FLIGHTTERM") == _NO_TERMINATION:
        columns.hold("chute_released", [0.0], [0.0])
    elif mode is not None and "flag_control_termination_enabled" in mode:
        columns.hold("chute_released", _times(mode), mode["flag_control_termination_enabled"])
    elif armed is not None and "force_failsafe" in armed:
        columns.hold("chute_released", _times(armed), armed["force_failsafe"])


def _lost(columns: Columns) -> None:
    """A position that never was there is not lost: the failsafe counts once it was valid."""
    invalid = columns.get("failsafe_gps")
    if invalid is not None:
        times, values = invalid
        columns.hold("failsafe_gps", times, values * np.maximum.accumulate(1.0 - values))


def _radio(topics: Topics, columns: Columns) -> None:
    """Raised while the link is lost and the vehicle is in a failsafe; a link that is not asked for raises none."""
    present, status = columns.get("rc_present"), topics.get("vehicle_status")
    if present is None or status is None or "failsafe" not in status:
        return
    times = np.union1d(present[0], _times(status))
    lost = _at(present[0], 1.0 - present[1], times)
    columns.hold("failsafe_radio", times, lost * _at(_times(status), np.asarray(status["failsafe"]), times))


def _orbit(topics: Topics, columns: Columns) -> None:
    """Add the radius of an orbit, 0 in other modes; the rate only where there was none."""
    mode = columns.get("mode")
    if "orbit_status" in topics and "radius" in topics["orbit_status"]:
        columns.hold("circle_radius_m", _times(topics["orbit_status"]), np.abs(topics["orbit_status"]["radius"]))
    if mode is None or (mode[1] == MODES["CIRCLE"]).any():
        return
    for signal in ("circle_radius_m", "circle_rate_dps"):
        columns.hold(signal, [0.0], [0.0])


def _at(at: Any, values: Any, times: Any) -> Any:
    return np.asarray(values, dtype=np.float64)[np.maximum(np.searchsorted(at, times + 1e-9, side="right") - 1, 0)]


def _times(topic: Topic) -> Any:
    return np.asarray(topic["timestamp"], dtype=np.float64) / 1e6
