"""PX4 flight logs (`.ulg`) as traces: local position, attitude, modes, landing, GPS, sticks, battery, texts.

Topics and fields are those of PX4's uORB messages (msg/*.msg), releases 1.8 to 1.16, each read where a log has it; what
failsafes and settings say is read by `ulog_states.py` and `settings.py`. Lean and modes of what flies or drives as
anything but a rotary wing (planes, VTOLs as planes, rovers, boats) are not told: the rules are those of multicopters.

PX4's modes are told by ArduCopter's numbers, as policies name them: position mode is LOITER, HOLD is BRAKE, offboard
and take-off are GUIDED, orbit is CIRCLE, descend and land are LAND.
"""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.flight import Trace
from saflite.contract.outside import LOG_BYTES_MAX, read_bytes
from saflite.contract.signals import MODES
from saflite.contract.test_case import Stimulus
from saflite.flight.logs import ulog_failures, ulog_states
from saflite.flight.logs.flight_log import (
    NO_ORDERS,
    UNTOLD,
    FlightLog,
    begins_in_flight,
    changed_by_hand,
    told_of,
    within,
)
from saflite.flight.logs.home import Homes, Place, add_home, homes_of_px4
from saflite.flight.logs.leaps import add_leaps_of_px4
from saflite.flight.logs.resample import POSITION, Columns
from saflite.flight.logs.settings import PX4, add_settings, sources
from saflite.flight.logs.targets import targets_of_px4
from saflite.flight.logs.topics import Topics, chosen, field, held
from saflite.flight.logs.ulog_bounds import TooMany, bounded
from saflite.flight.logs.ulog_commands import commands_of
from saflite.flight.mission import to_local

_MAGIC = b"ULog\x01\x12\x35"
MODE_NAMES: dict[int, str] = {
    0: "STABILIZE",
    1: "ALT_HOLD",
    2: "LOITER",
    3: "AUTO",
    4: "BRAKE",
    5: "RTL",
    10: "ACRO",
    12: "LAND",
    14: "GUIDED",
    15: "STABILIZE",
    17: "GUIDED",
    18: "LAND",
    19: "GUIDED",
    20: "LAND",
    21: "CIRCLE",
}
OTHER_MODE = -1.0
_TAKEOFF = 17
_TAKEOFF_ORDERS = (22, 84)  # MAV_CMD_NAV_TAKEOFF, MAV_CMD_NAV_VTOL_TAKEOFF
_ROTARY_WING = 1  # vehicle_status.VEHICLE_TYPE_ROTARY_WING; 0 is not known
ARMED = 2
FIX_3D = 3
_WANTED = tuple(
    "vehicle_local_position vehicle_global_position vehicle_attitude vehicle_angular_velocity vehicle_status"  # noqa: SIM905
    " mission_result vehicle_gps_position sensor_gps manual_control_setpoint battery_status home_position"
    " vehicle_local_position_setpoint vehicle_land_detected vehicle_command failsafe_flags vehicle_status_flags"
    " vehicle_command_ack geofence_result vehicle_air_data vehicle_control_mode actuator_armed orbit_status"
    " estimator_status estimator_status_flags actuator_motors failure_detector_status sensor_combined".split()
)
_NO_COPTERS = (1, 7, 8, 9, 10, 11, 12, 16)  # MAV_TYPE of planes, airships, balloons, rockets, rovers, boats, wings
_LOCAL = {"x": ("x_m", 1.0), "y": ("y_m", 1.0), "z": ("altitude_m", -1.0)}
_SPEED = {"vx": ("vx_mps", 1.0), "vy": ("vy_mps", 1.0), "vz": ("climb_mps", -1.0)}
_GLOBAL_SPEED = {"vel_n": ("vx_mps", 1.0), "vel_e": ("vy_mps", 1.0), "vel_d": ("climb_mps", -1.0)}
_RATES = ("roll_rate_dps", "pitch_rate_dps", "yaw_rate_dps")
_PLACE = "vehicle_local_position or vehicle_global_position"
SOURCES = {
    **dict.fromkeys(("x_m", "y_m", "altitude_m", "vx_mps", "vy_mps", "climb_mps"), _PLACE),
    **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), "vehicle_attitude"),
    **dict.fromkeys(_RATES, "vehicle_angular_velocity"),
    **dict.fromkeys(("mode", "armed", "takeoff", "above_ground_m"), "vehicle_status"),
    **dict.fromkeys(("mission_item", "mission_count"), "mission_result"),
    **dict.fromkeys(("gps_satellites", "gps_ok"), "vehicle_gps_position or sensor_gps"),
    **{f"rc{number}_pwm": "manual_control_setpoint" for number in range(1, 5)},
    "battery_v": "battery_status",
    "altitude_target_m": "vehicle_local_position_setpoint",
    "home_distance_m": "home_position, else from where the log begins",
    **ulog_states.SOURCES,
    **ulog_failures.SOURCES,
    **NO_ORDERS,
    **sources(PX4),
    "takeoff_altitude_set_m": "parameter MIS_TAKEOFF_ALT with vehicle_command and home_position",
}
DAMAGED = "parts of the file are no messages; what could be read before and after them was"
NO_HOME = "home_position, without which a log that begins in the air does not tell heights and places"


class _Load(NamedTuple):
    topics: Topics
    texts: list[tuple[float, str, str]]
    parameters: dict[str, float]
    changes: list[tuple[float, str, float]]
    began_s: float
    lost: tuple[str, ...] = ()


def read_ulog(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in a PX4 log; raises as `read_ulog_log` does."""
    return read_ulog_log(path, placed=placed).trace


def read_ulog_log(path: Path, *, placed: bool = False) -> FlightLog:
    """Return what a PX4 log tells.

    Raises:
        Refused: the file is missing, is no ULog, is damaged, or lacks a position (if `placed`) or all signals.
    """
    topics, texts, parameters, changes, began_s, lost = _load(path)
    columns = Columns(began_s)
    columns.messages = texts
    frame = _position(topics, columns)
    readers = (_attitude, _status, _ground, _gps, _sticks, _battery, _aims, ulog_states.add)
    for reader in readers:
        reader(topics, columns)
    add_leaps_of_px4(topics, columns)
    add_settings(columns, PX4, parameters, changes)
    _takeoff_height(topics, columns)
    targets = targets_of_px4(topics, columns)
    ulog_states.add_position_aided(topics, parameters, changes, columns)
    ulog_states.add_parachute(topics, parameters, columns)
    ulog_states.add_fence_that_never_acts(parameters, changes, columns)
    ulog_failures.add_throttle(topics, columns)
    crashed = ulog_failures.add_crash(topics, parameters, changes, columns)
    homes = homes_of_px4(topics, frame)
    homeless = () if placed else _from_home(homes, columns)
    add_home(columns, homes)
    set_by_hand = [
        Stimulus(at_s=at, kind="parameter", name=name, values=(value,))
        for at, name, value in changes
        if changed_by_hand(name)
    ]
    trace = columns.trace("PX4 log", str(path), placed=placed)
    given = [*set_by_hand, *commands_of(topics), *targets]
    stimuli = within(given, *columns.span("PX4 log", str(path), placed=placed))
    told = {**told_of(SOURCES, topics, columns), **dict.fromkeys(homeless, NO_HOME)}
    return FlightLog(trace, stimuli, told, crashed, UNTOLD, lost)


def _load(path: Path) -> _Load:
    from pyulog.exceptions import ULogException

    try:
        data = read_bytes(path, "PX4 log", LOG_BYTES_MAX)  # once: it may be another file, or cut, a moment later
        start = data[: len(_MAGIC)]
        if start != _MAGIC:
            raise Refused(
                "PX4 log",
                where=str(path),
                expected="a ULog file",
                got=f"{start[:8]!r} at its start" if start else "an empty file",
            )
        _check_one(data, path)
        log = bounded()(BytesIO(data), _WANTED)
    except TooMany as fault:
        raise Refused("PX4 log", where=str(path), expected=f"at most {fault} messages", got="more") from fault
    except (OSError, ValueError, TypeError, LookupError, AttributeError, struct.error, ULogException) as fault:
        raise Refused("PX4 log", where=str(path), expected="a whole ULog file", got=repr(fault)) from fault
    topics, far_off = chosen(log.data_list)
    if not topics and set(_WANTED).isdisjoint(log.message_formats):
        raise Refused("PX4 log", where=str(path), expected="messages of PX4's flights", got=_others(log))
    texts = [(text.timestamp / 1e6, text.message, _severity(text.log_level)) for text in log.logged_messages]
    parameters = {str(name): float(value) for name, value in log.initial_parameters.items()}
    changes = [(stamp / 1e6, str(name), float(value)) for stamp, name, value in log.changed_parameters]
    lost = ((DAMAGED,) if log.file_corruption else ()) + far_off
    return _Load(topics, texts, parameters, changes, log.start_timestamp / 1e6, lost)


def _others(log: Any) -> str:
    """Name what is logged in place of flights: other autopilots use the format, too."""
    return ", ".join(sorted(log.message_formats)[:5]) or "none"


def _check_one(data: bytes, path: Path) -> None:
    """Raise Refused for logs put one behind the other: the library reads the first and says nothing of the rest."""
    second = data.find(_MAGIC, len(_MAGIC))
    if second >= 0:
        got = f"another that begins at byte {second}; cut it there, and judge them one by one"
        raise Refused("PX4 log", where=str(path), expected="one ULog file", got=got)


def _severity(level: int) -> str:
    """Syslog level as ULog stores it (character or number) to our three words."""
    number = level - ord("0") if level >= ord("0") else level
    return "error" if number <= 3 else "warning" if number == 4 else "info"


def _position(topics: Topics, columns: Columns) -> Place | None:
    """Add where it is and how fast: as the controllers see it, in its place the geographic estimate.

    Return the place from which the latter counts, None where the former is told.
    """
    name = "vehicle_local_position"
    for told, (signal, sign) in {**_LOCAL, **_SPEED}.items():
        found = field(topics, name, told)
        if found is None:
            continue
        says = {"z": "z_valid", "vz": "v_z_valid", "vx": "v_xy_valid", "vy": "v_xy_valid"}.get(told, "xy_valid")
        valid = field(topics, name, says)
        values = found[1] * sign
        columns.add(signal, found[0], values if valid is None else np.where(valid[1] > 0, values, np.nan))
    if all(signal in columns for signal in POSITION):
        return None
    name = "vehicle_global_position"
    places = [field(topics, name, part) for part in ("lat", "lon", "alt")]
    if None in places:
        return None
    (at_s, north), (_, east), (_, height) = (place for place in places if place is not None)
    local = np.array([to_local(lat, lon, north[0], east[0]) for lat, lon in zip(north, east, strict=True)])
    for signal, values in zip(POSITION, (*local.T, height), strict=True):
        columns.add(signal, at_s, values)
    for told, (signal, sign) in _GLOBAL_SPEED.items():
        found = field(topics, name, told)
        if found is not None and signal not in columns:
            columns.add(signal, at_s, found[1] * sign)
    return float(north[0]), float(east[0])


def _attitude(topics: Topics, columns: Columns) -> None:
    turned = [field(topics, "vehicle_attitude", f"q[{i}]") for i in range(4)]
    if None not in turned:
        at_s = turned[0][0]  # type: ignore[index]  # none of them is None
        w, x, y, z = (part[1] for part in turned if part is not None)
        hovers = _hovers(topics, at_s)
        roll, pitch = (
            np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
        )
        columns.add("roll_deg", at_s, np.where(hovers, np.degrees(roll), np.nan))
        columns.add("pitch_deg", at_s, np.where(hovers, np.degrees(pitch), np.nan))
        columns.add("yaw_deg", at_s, np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))
    for index, signal in enumerate(_RATES):
        older = ("rollspeed", "pitchspeed", "yawspeed")[index]
        found = field(topics, "vehicle_angular_velocity", f"xyz[{index}]") or field(topics, "vehicle_attitude", older)
        if found is not None:
            columns.add(signal, found[0], np.where(_hovers(topics, found[0]), np.degrees(found[1]), np.nan))


def _status(topics: Topics, columns: Columns) -> None:
    states = field(topics, "vehicle_status", "nav_state")
    if states is not None:
        named = [float(MODES[MODE_NAMES[state]]) if state in MODE_NAMES else OTHER_MODE for state in states[1]]
        columns.add("mode", states[0], np.where(_hovers(topics, states[0]), named, OTHER_MODE))
        columns.add("takeoff", states[0], states[1] == _TAKEOFF)
    arming = field(topics, "vehicle_status", "arming_state")
    if arming is not None:
        columns.add("armed", arming[0], arming[1] == ARMED)
    for told, signal in (("seq_current", "mission_item"), ("seq_total", "mission_count")):
        mission = field(topics, "mission_result", told)
        if mission is not None:
            columns.add(signal, *mission)


def _takeoff_height(topics: Topics, columns: Columns) -> None:
    """Let a take-off that was ordered to a height aim there (vehicle_command, above sea), the others at the setting."""
    name = "takeoff_altitude_set_m"
    takeoff, setting = columns.get("takeoff"), columns.get(name)
    if takeoff is None or setting is None or not takeoff[1].any():
        return
    orders, heights = field(topics, "vehicle_command", "command"), field(topics, "vehicle_command", "param7")
    home = field(topics, "home_position", "alt")
    if orders is None or heights is None:
        columns.drop(name)
        return
    aims = list(zip(*setting, strict=True))
    for number in np.flatnonzero(np.isin(orders[1], _TAKEOFF_ORDERS)):
        at_s, above_sea_m = (float(part[number]) for part in heights)
        if np.isfinite(above_sea_m):
            aims.append((at_s, above_sea_m - float(held(home, at_s)) if home is not None else np.nan))
        else:
            aims.append((at_s, float(held(setting, at_s))))
    columns.drop(name)
    if np.isfinite([aim for _, aim in aims]).all():
        columns.hold(name, *zip(*sorted(aims), strict=True))


def _hovers(topics: Topics, at_s: Any) -> Any:
    """Say when the vehicle moves as a rotary wing."""
    kind, rotary = field(topics, "vehicle_status", "vehicle_type"), field(topics, "vehicle_status", "is_rotary_wing")
    built = field(topics, "vehicle_status", "system_type")
    hovers = np.full(np.shape(at_s), True)
    if kind is not None:
        hovers &= np.isin(held(kind, at_s), (0, _ROTARY_WING))
    elif rotary is not None:
        hovers &= held(rotary, at_s) > 0
    return hovers if built is None else hovers & ~np.isin(held(built, at_s), _NO_COPTERS)


def _aims(topics: Topics, columns: Columns) -> None:
    """Add the height the controller aims at; where it aims at none (NaN) the estimate."""
    aim, height = field(topics, "vehicle_local_position_setpoint", "z"), columns.get("altitude_m")
    if aim is not None and height is not None:
        aimed = np.where(np.isfinite(aim[1]), -aim[1], np.interp(aim[0], *height))
        columns.add("altitude_target_m", aim[0], aimed)


def _ground(topics: Topics, columns: Columns) -> None:
    landed = field(topics, "vehicle_land_detected", "landed")
    if landed is not None:
        columns.add("landed", *landed)


def _gps(topics: Topics, columns: Columns) -> None:
    name = "vehicle_gps_position" if "vehicle_gps_position" in topics else "sensor_gps"
    satellites, fix = field(topics, name, "satellites_used"), field(topics, name, "fix_type")
    if satellites is not None:
        columns.add("gps_satellites", *satellites)
    if fix is not None:
        columns.add("gps_ok", fix[0], fix[1] >= FIX_3D)


def _sticks(topics: Topics, columns: Columns) -> None:
    """Add the sticks while they are valid; where they never are nobody moves any, and they stand in the middle."""
    name = "manual_control_setpoint"
    older, valid = "x" in topics.get(name, {}), field(topics, name, "valid")
    fields = ("y", "x", "z", "r") if older else ("roll", "pitch", "throttle", "yaw")
    for number, told in enumerate(fields, start=1):
        found = field(topics, name, told)
        if found is None:
            continue
        at_s, value = found
        if number == 3 and older:
            value = 2 * value - 1  # throttle ran from 0 to 1 before PX4 1.14
        pwm = 1500 + 500 * (-value if number == 2 else value)
        if valid is not None:
            pwm = np.where(valid[1] > 0, pwm, np.nan if (valid[1] > 0).any() else 1500.0)
        columns.add(f"rc{number}_pwm", at_s, pwm)


def _battery(topics: Topics, columns: Columns) -> None:
    volts = field(topics, "battery_status", "voltage_v")
    if volts is not None:
        columns.add("battery_v", *volts)


def _from_home(homes: Homes | None, columns: Columns) -> tuple[str, ...]:
    """Measure places of a log that begins in the air from home; return what is not known where home is not told."""
    if not begins_in_flight(columns):
        return ()
    if homes is not None:
        first = (float(part[0]) for part in homes[1:])
        columns.origin = dict(zip(POSITION, first, strict=True))
        return ()
    return columns.drop(*POSITION, "altitude_target_m", "baro_altitude_m")
