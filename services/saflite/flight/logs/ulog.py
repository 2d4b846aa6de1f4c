"""PX4 flight logs (`.ulg`) as traces: local position, attitude, modes, landing, GPS, sticks, battery, texts.

Topics and fields are those of PX4's uORB messages (msg/*.msg), releases 1.8 to 1.16; what failsafes and settings say is
read by `ulog_states.py` and `settings.py`.

PX4's modes are told by ArduCopter's numbers, as policies name them: position mode is LOITER, HOLD is BRAKE, offboard
and take-off are GUIDED, orbit is CIRCLE, descend and land are LAND.
"""

from __future__ import annotations

import struct
from collections.abc import Container, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.flight import Trace
from saflite.contract.signals import MODES
from saflite.contract.test_case import Stimulus
from saflite.flight.logs import ulog_states
from saflite.flight.logs.commands import command
from saflite.flight.logs.flight_log import NO_ORDERS, UNTOLD, FlightLog, changed_by_hand, within
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.settings import PX4, add_settings, sources

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
_ROTARY_WING = 1  # vehicle_status.VEHICLE_TYPE_ROTARY_WING; 0 is not known
ARMED = 2
FIX_3D = 3
FIELDS_MAX = 500_000
"""Of all subscriptions of a log together; logs of flights have some thousand."""
NESTED_MAX = 16
_LOCAL = {"x": ("x_m", 1.0), "y": ("y_m", 1.0), "z": ("altitude_m", -1.0)}
_SPEED = {"vx": ("vx_mps", 1.0), "vy": ("vy_mps", 1.0), "vz": ("climb_mps", -1.0)}
_RATES = ("roll_rate_dps", "pitch_rate_dps", "yaw_rate_dps")

Topic = Mapping[str, Any]


SOURCES = {
    **dict.fromkeys(("x_m", "y_m", "altitude_m", "vx_mps", "vy_mps", "climb_mps"), "vehicle_local_position"),
    **dict.fromkeys(("roll_deg", "pitch_deg", "yaw_deg"), "vehicle_attitude"),
    **dict.fromkeys(_RATES, "vehicle_angular_velocity"),
    **dict.fromkeys(("mode", "armed", "takeoff"), "vehicle_status"),
    **dict.fromkeys(("mission_item", "mission_count"), "mission_result"),
    **dict.fromkeys(("gps_satellites", "gps_ok"), "vehicle_gps_position or sensor_gps"),
    **{f"rc{number}_pwm": "manual_control_setpoint" for number in range(1, 5)},
    "battery_v": "battery_status",
    "altitude_target_m": "vehicle_local_position_setpoint",
    **ulog_states.SOURCES,
    **NO_ORDERS,
    **sources(PX4),
}


class _Load(NamedTuple):
    topics: dict[str, Topic]
    texts: list[tuple[float, str, str]]
    parameters: dict[str, float]
    changes: list[tuple[float, str, float]]


def read_ulog(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in a PX4 log; raises as `read_ulog_log` does."""
    return read_ulog_log(path, placed=placed).trace


def read_ulog_log(path: Path, *, placed: bool = False) -> FlightLog:
    """Return what a PX4 log tells.

    Raises:
        Refused: the file is missing, is no ULog, is damaged, or lacks a position (if `placed`) or all signals.
    """
    topics, texts, parameters, changes = _load(path)
    columns = Columns()
    columns.messages = texts
    readers = (_position, _attitude, _status, _ground, _gps, _sticks, _battery, _aims, ulog_states.add)
    for reader in readers:
        reader(topics, columns)
    add_settings(columns, PX4, parameters, changes)
    ulog_states.add_parachute(topics, parameters, columns)
    set_by_hand = [
        Stimulus(at_s=at, kind="parameter", name=name, values=(value,))
        for at, name, value in changes
        if changed_by_hand(name)
    ]
    trace = columns.trace("PX4 log", str(path), placed=placed)
    stimuli = within([*set_by_hand, *_commands(topics)], *columns.span("PX4 log", str(path), placed=placed))
    return FlightLog(trace, stimuli, SOURCES, untold=UNTOLD)


def _load(path: Path) -> _Load:
    from pyulog.exceptions import ULogException

    try:
        with path.open("rb") as file:
            start = file.read(len(_MAGIC))
        if start != _MAGIC:
            raise Refused("PX4 log", where=str(path), expected="a ULog file", got=f"{start[:8]!r} at its start")
        log = _bounded()(str(path))
    except (OSError, ValueError, TypeError, LookupError, AttributeError, struct.error, ULogException) as fault:
        raise Refused("PX4 log", where=str(path), expected="a whole ULog file", got=repr(fault)) from fault
    topics = {dataset.name: dataset.data for dataset in reversed(log.data_list) if len(dataset.data["timestamp"]) > 0}
    texts = [(text.timestamp / 1e6, text.message, _severity(text.log_level)) for text in log.logged_messages]
    parameters = {str(name): float(value) for name, value in log.initial_parameters.items()}
    changes = [(stamp / 1e6, str(name), float(value)) for stamp, name, value in log.changed_parameters]
    return _Load(topics, texts, parameters, changes)


def _bounded() -> Any:
    """Return the reader for one log; it raises ValueError before the formats subscribed to unfold to too many fields.

    The library makes an object of each field of each subscription, arrays and formats in formats unfolded: six formats
    of a hundred each of the next are some 300 bytes and 10^12 fields.
    """
    from pyulog import ULog

    left = FIELDS_MAX

    class Subscription(ULog._MessageAddLogged):  # type: ignore[misc]  # the library has no types
        def _parse_format(self, formats: Mapping[str, Any]) -> None:
            nonlocal left
            left -= _fields(self.message_name, formats, ULog._UNPACK_TYPES, {})
            if left < 0:
                raise ValueError(f"formats that unfold to more than {FIELDS_MAX} fields")
            super()._parse_format(formats)

    return type("Bounded", (ULog,), {"_MessageAddLogged": Subscription})


def _fields(name: str, formats: Mapping[str, Any], plain: Container[str], known: dict[str, int], depth: int = 0) -> int:
    """Return how many fields a format unfolds to, one at least."""
    if depth > NESTED_MAX:
        raise ValueError(f"formats nested deeper than {NESTED_MAX}")
    if name not in known:
        known[name] = 1 + sum(
            max(1, many) * (1 if kind in plain else _fields(kind, formats, plain, known, depth + 1))
            for kind, many, _ in formats[name].fields
        )
    return known[name]


def _commands(topics: Mapping[str, Topic]) -> list[Stimulus]:
    """Return the commands that came from outside the vehicle (vehicle_command.from_external)."""
    topic = topics.get("vehicle_command")
    if topic is None or "from_external" not in topic:
        return []
    values = [np.asarray(topic[f"param{number}"], dtype=np.float64) for number in range(1, 8)]
    told = zip(_times(topic), topic["command"], topic["from_external"], *values, strict=True)
    made = [command(float(at), int(number), given) for at, number, outside, *given in told if outside]
    return [one for one in made if one is not None]


def _severity(level: int) -> str:
    """Syslog level as ULog stores it (character or number) to our three words."""
    number = level - ord("0") if level >= ord("0") else level
    return "error" if number <= 3 else "warning" if number == 4 else "info"


def _times(topic: Topic) -> Any:
    return np.asarray(topic["timestamp"], dtype=np.float64) / 1e6


def _first(topics: Mapping[str, Topic], *names: str) -> Topic | None:
    return next((topics[name] for name in names if name in topics), None)


def _position(topics: Mapping[str, Topic], columns: Columns) -> None:
    topic = _first(topics, "vehicle_local_position")
    if topic is None:
        return
    for field, (signal, sign) in {**_LOCAL, **_SPEED}.items():
        if field not in topic:
            continue
        valid = topic.get({"z": "z_valid", "vz": "v_z_valid"}.get(field, "xy_valid"))
        values = np.asarray(topic[field], dtype=np.float64) * sign
        columns.add(signal, _times(topic), values if valid is None else np.where(valid, values, np.nan))


def _attitude(topics: Mapping[str, Topic], columns: Columns) -> None:
    topic = _first(topics, "vehicle_attitude")
    if topic is not None and "q[0]" in topic:
        w, x, y, z = (np.asarray(topic[f"q[{i}]"], dtype=np.float64) for i in range(4))
        columns.add("roll_deg", _times(topic), np.degrees(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))))
        columns.add("pitch_deg", _times(topic), np.degrees(np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))))
        columns.add("yaw_deg", _times(topic), np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))
    rates = _first(topics, "vehicle_angular_velocity", "vehicle_attitude")
    for index, name in enumerate(_RATES):
        field = (f"xyz[{index}]", ("rollspeed", "pitchspeed", "yawspeed")[index])
        found = next((key for key in field if rates is not None and key in rates), None)
        if rates is not None and found:
            columns.add(name, _times(rates), np.degrees(np.asarray(rates[found], dtype=np.float64)))


def _status(topics: Mapping[str, Topic], columns: Columns) -> None:
    topic = _first(topics, "vehicle_status")
    if topic is None:
        return
    states = [int(state) for state in topic["nav_state"]]
    named = [float(MODES[MODE_NAMES[state]]) if state in MODE_NAMES else OTHER_MODE for state in states]
    columns.add("mode", _times(topic), np.where(_hovers(topic), named, OTHER_MODE))
    columns.add("takeoff", _times(topic), [float(state == _TAKEOFF) for state in states])
    if "arming_state" in topic:
        columns.add("armed", _times(topic), np.asarray(topic["arming_state"]) == ARMED)
    if "rc_signal_lost" in topic:
        columns.add("rc_present", _times(topic), np.asarray(topic["rc_signal_lost"]) == 0)
    if "mission_result" in topics and "seq_current" in topics["mission_result"]:
        result = topics["mission_result"]
        columns.add("mission_item", _times(result), result["seq_current"])
        columns.add("mission_count", _times(result), result["seq_total"])


def _hovers(topic: Topic) -> Any:
    """Say when the vehicle flies as a rotary wing: the rules of modes are those of one."""
    if "vehicle_type" in topic:
        return np.isin(topic["vehicle_type"], (0, _ROTARY_WING))
    return (
        np.asarray(topic["is_rotary_wing"]) > 0 if "is_rotary_wing" in topic else np.full(len(topic["nav_state"]), True)
    )


def _aims(topics: Mapping[str, Topic], columns: Columns) -> None:
    """Add the height the controller aims at; where it aims at none (NaN) the estimate."""
    topic, height = topics.get("vehicle_local_position_setpoint"), columns.get("altitude_m")
    if topic is None or height is None:
        return
    aimed = -np.asarray(topic["z"], dtype=np.float64)
    columns.add(
        "altitude_target_m", _times(topic), np.where(np.isfinite(aimed), aimed, np.interp(_times(topic), *height))
    )


def _ground(topics: Mapping[str, Topic], columns: Columns) -> None:
    topic = _first(topics, "vehicle_land_detected")
    if topic is not None and "landed" in topic:
        columns.add("landed", _times(topic), topic["landed"])


def _gps(topics: Mapping[str, Topic], columns: Columns) -> None:
    topic = _first(topics, "vehicle_gps_position", "sensor_gps")
    if topic is None:
        return
    columns.add("gps_satellites", _times(topic), topic["satellites_used"])
    columns.add("gps_ok", _times(topic), np.asarray(topic["fix_type"]) >= FIX_3D)


def _sticks(topics: Mapping[str, Topic], columns: Columns) -> None:
    topic = _first(topics, "manual_control_setpoint")
    if topic is None:
        return
    older = "x" in topic
    fields = ("y", "x", "z", "r") if older else ("roll", "pitch", "throttle", "yaw")
    for number, field in enumerate(fields, start=1):
        if field not in topic:
            continue
        value = np.asarray(topic[field], dtype=np.float64)
        if number == 3 and older:
            value = 2 * value - 1  # throttle ran from 0 to 1 before PX4 1.14
        columns.add(f"rc{number}_pwm", _times(topic), 1500 + 500 * (-value if number == 2 else value))


def _battery(topics: Mapping[str, Topic], columns: Columns) -> None:
    topic = _first(topics, "battery_status")
    if topic is not None and "voltage_v" in topic:
        columns.add("battery_v", _times(topic), topic["voltage_v"])
