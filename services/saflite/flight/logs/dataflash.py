"""ArduPilot flight logs (`.bin`) as traces, through pymavlink: estimate, attitude, modes, events, failsafes, sticks.

Messages and fields are those of ArduPilot's LogStructure; events and errors those of LogEvent and LogErrorSubsystem.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from pathlib import Path
from typing import Any, NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.flight import Trace
from saflite.contract.signals import MODES
from saflite.contract.test_case import Stimulus
from saflite.flight.logs.commands import command
from saflite.flight.logs.flight_log import (
    NO_ORDERS,
    UNTOLD,
    FlightLog,
    add_taken_off,
    changed_by_hand,
    stands_by_height,
    within,
)
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.settings import ARDUPILOT, add_settings, sources
from saflite.flight.mission import to_local

_HEAD = b"\xa3\x95"
HEAD_BYTES = len(_HEAD) + 1  # and the number of the format
_ESTIMATORS = ("XKF1", "NKF1")
_MESSAGES = ("POS", "ATT", "RATE", "MODE", "EV", "ERR", "GPS", "BARO", "RCIN", "BAT", "CTUN", "MSG", "MISE", "MAVC")
_WANTED = (*_ESTIMATORS, *_MESSAGES, "PARM", "ARM")
_FIELDS: dict[str, dict[str, str]] = {
    "ATT": {"Roll": "roll_deg", "Pitch": "pitch_deg", "Yaw": "yaw_deg"},
    "RATE": {"R": "roll_rate_dps", "P": "pitch_rate_dps", "Y": "yaw_rate_dps"},
    "MODE": {"ModeNum": "mode"},
    "GPS": {"NSats": "gps_satellites"},
    "BARO": {"Alt": "baro_altitude_m"},
    "BAT": {"Volt": "battery_v"},
    "CTUN": {"DAlt": "altitude_target_m", "ThO": "throttle"},
    "MISE": {"CNum": "mission_item", "CTot": "mission_count"},
}
_OF_COMMANDS = ("command_quiet_s", "place_order_s", "ordered_x_m", "ordered_y_m", "ordered_altitude_m", "yaw_order_s")
_SOURCES = {
    **dict.fromkeys(("x_m", "y_m"), "XKF1, NKF1 or POS"),
    **dict.fromkeys(("altitude_m",), "XKF1, NKF1, POS or CTUN.Alt"),
    **dict.fromkeys(("vx_mps", "vy_mps", "climb_mps"), "XKF1 or NKF1"),
    **{signal: f"{kind}.{field}" for kind, fields in _FIELDS.items() for field, signal in fields.items()},
    **{f"rc{number}_pwm": "RCIN" for number in range(1, 5)},
    **dict.fromkeys(("failsafe_radio", "failsafe_battery", "failsafe_gps", "failsafe_fence", "crashed"), "EV and ERR"),
    **dict.fromkeys(("armed", "landed", "taken_off", "chute_released", "stop_ordered", "rc_present"), "EV"),
    **dict.fromkeys(("circle_radius_m", "circle_rate_dps"), "no message: what CIRCLE aims at is not logged"),
    **dict.fromkeys(_OF_COMMANDS, "MAVC"),
    **NO_ORDERS,
    "takeoff": "MISE",
    "gps_ok": "GPS.Status",
    "baro_ok": "BARO",
    **sources(ARDUPILOT),
}
_EVENTS: dict[int, tuple[str, float]] = {
    10: ("armed", 1.0),
    11: ("armed", 0.0),
    18: ("landed", 1.0),
    28: ("landed", 0.0),
    51: ("chute_released", 1.0),
    54: ("stop_ordered", 1.0),
    56: ("stop_ordered", 1.0),
}
_FAILSAFES: dict[int, str] = {
    5: "failsafe_radio",
    6: "failsafe_battery",
    7: "failsafe_gps",
    9: "failsafe_fence",
    12: "crashed",
    17: "failsafe_gps",
}
_FIX_3D = 3
_NAV_TAKEOFF = 22
_CM_PER_M = 100.0
_OTHERS = ("ArduPlane", "ArduRover", "ArduSub", "Rover", "Blimp", "AntennaTracker")

Row = tuple[float, dict[str, Any]]


class _Load(NamedTuple):
    rows: dict[str, list[Row]]
    formats: dict[str, str]  # by kind of message the format letters of its fields


def read_dataflash(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in an ArduPilot log; raises as `read_dataflash_log` does."""
    return read_dataflash_log(path, placed=placed).trace


def read_dataflash_log(path: Path, *, placed: bool = False) -> FlightLog:
    """Return what an ArduCopter log tells.

    Raises:
        Refused: the file is missing, is no dataflash log, is damaged, is not of a copter, or lacks a position (if
            `placed`) or all signals.
    """
    rows, formats = _load(path)
    _check_copter(rows, path)
    columns = Columns()
    _position(rows, columns)
    _height(rows, formats, columns)
    for kind, fields in _FIELDS.items():
        for field, signal in fields.items():
            _column(columns, signal, [(at, row[field]) for at, row in rows[kind] if field in row])
    _column(columns, "gps_ok", [(at, float(row["Status"] >= _FIX_3D)) for at, row in rows["GPS"] if "Status" in row])
    _sticks(rows, columns)
    _events(rows, formats, columns)
    _modes(rows, columns)
    changes = _parameters(rows, columns)
    columns.messages = [(at, str(row.get("Message", "")), "info") for at, row in rows["MSG"]]
    trace = columns.trace("ArduPilot log", str(path), placed=placed)
    given = [*changes, *_commands(rows)]
    stimuli = within(given, *columns.span("ArduPilot log", str(path), placed=placed))
    crashed = "crashed" in columns and bool(trace.array("crashed").any())
    return FlightLog(trace, stimuli, _SOURCES, crashed, UNTOLD if "MAVC" in formats else UNTOLD.union(_OF_COMMANDS))


def _check_copter(rows: dict[str, list[Row]], path: Path) -> None:
    said = [str(row.get("Message", "")) for _, row in rows["MSG"]]
    other = next((text for text in said if text.startswith(_OTHERS)), None)
    if other:
        raise Refused("ArduPilot log", where=str(path), expected="an ArduCopter log", got=other)


def _parameters(rows: dict[str, list[Row]], columns: Columns) -> list[Stimulus]:
    """Add the settings in force and return what was changed in flight; the first value of each is what it was."""
    held: dict[str, float] = {}
    changes: list[tuple[float, str, float]] = []
    for at, row in rows["PARM"]:
        name, value = str(row["Name"]), float(row["Value"])
        if name in held and held[name] != value:
            changes.append((at, name, value))
        held[name] = value
    first = {str(row["Name"]): float(row["Value"]) for _, row in reversed(rows["PARM"])}
    add_settings(columns, ARDUPILOT, first, changes)
    if first and "chute_released" not in columns and not first.get("CHUTE_ENABLED"):
        columns.hold("chute_released", [0.0], [0.0])  # there is none on board
    return [
        Stimulus(at_s=at, kind="parameter", name=name, values=(value,))
        for at, name, value in changes
        if changed_by_hand(name)
    ]


def _commands(rows: dict[str, list[Row]]) -> list[Stimulus]:
    """Return the commands that came over MAVLink (MAVC)."""
    fields = ("P1", "P2", "P3", "P4", "X", "Y", "Z")
    made = (command(at, int(row["Cmd"]), [float(row.get(name, 0.0)) for name in fields]) for at, row in rows["MAVC"])
    return [one for one in made if one is not None]


def _load(path: Path) -> _Load:
    rows: dict[str, list[Row]] = defaultdict(list)
    try:
        with path.open("rb") as file:
            start = file.read(len(_HEAD))
        if start != _HEAD:
            raise Refused("ArduPilot log", where=str(path), expected="a dataflash log", got=f"{start!r} at its start")
        log = _reader()(str(path))
        while (message := log.recv_match(type=list(_WANTED))) is not None:
            kind, fields = message.get_type(), message.to_dict()
            if fields.get("C", fields.get("I", 0)) in (0, "0") or kind not in (*_ESTIMATORS, "GPS", "BARO", "BAT"):
                rows[kind].append((fields.get("TimeUS", message._timestamp * 1e6) / 1e6, fields))
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error) as fault:
        raise Refused("ArduPilot log", where=str(path), expected="a whole dataflash log", got=repr(fault)) from fault
    formats = {kind.name: kind.format for kind in log.formats.values()}
    return _Load(rows, formats)


class _Formats(dict[int, Any]):
    """Formats by number; none shorter than a message's head, by which the library would go on without end."""

    def __setitem__(self, number: int, kind: Any) -> None:
        if kind.len < HEAD_BYTES:
            raise ValueError(f"format {number} of {kind.len} bytes a message, fewer than the head has")
        super().__setitem__(number, kind)


def _reader() -> Any:
    """Return the library's reader with formats that are checked."""
    from pymavlink import DFReader

    class Reader(DFReader.DFReader_binary):  # type: ignore[misc]  # the library has no types
        @property
        def formats(self) -> _Formats:
            return self._formats

        @formats.setter
        def formats(self, found: dict[int, Any]) -> None:
            self._formats = _Formats(found)

    return Reader


def _column(columns: Columns, signal: str, points: list[tuple[float, float]]) -> None:
    if points:
        times, values = zip(*points, strict=True)
        columns.add(signal, times, values)


def _position(rows: dict[str, list[Row]], columns: Columns) -> None:
    estimator = next((kind for kind in _ESTIMATORS if rows[kind]), None)
    if estimator is None:
        _geographic(rows, columns)
        return
    fields = {"PN": ("x_m", 1.0), "PE": ("y_m", 1.0), "PD": ("altitude_m", -1.0)}
    speeds = {"VN": ("vx_mps", 1.0), "VE": ("vy_mps", 1.0), "VD": ("climb_mps", -1.0)}
    for field, (signal, sign) in {**fields, **speeds}.items():
        _column(columns, signal, [(at, sign * row[field]) for at, row in rows[estimator] if field in row])


def _geographic(rows: dict[str, list[Row]], columns: Columns) -> None:
    """Fall back on the POS message: degrees and the height above home."""
    points = rows["POS"]
    if not points:
        return
    home = points[0][1]
    local = [to_local(row["Lat"], row["Lng"], home["Lat"], home["Lng"]) for _, row in points]
    _column(columns, "x_m", [(at, x) for (at, _), (x, _) in zip(points, local, strict=True)])
    _column(columns, "y_m", [(at, y) for (at, _), (_, y) in zip(points, local, strict=True)])
    _column(
        columns,
        "altitude_m",
        [(at, float(row["RelHomeAlt"] if "RelHomeAlt" in row else row["Alt"])) for at, row in points],
    )


def _height(rows: dict[str, list[Row]], formats: dict[str, str], columns: Columns) -> None:
    """Add the height of CTUN where no estimate was logged, that the barometer answers, and what CIRCLE shows outside.

    CTUN.CRt is in cm/s where it is a whole number.
    """
    if "altitude_m" not in columns:
        _column(columns, "altitude_m", [(at, float(row["Alt"])) for at, row in rows["CTUN"] if "Alt" in row])
        if formats.get("CTUN", "").endswith("h"):
            _column(columns, "climb_mps", [(at, row["CRt"] / _CM_PER_M) for at, row in rows["CTUN"] if "CRt" in row])
    _column(columns, "baro_ok", [(at, float(bool(row.get("H", row.get("Health", 1))))) for at, row in rows["BARO"]])


def _sticks(rows: dict[str, list[Row]], columns: Columns) -> None:
    """Add the sticks as fractions of their calibrated way: 1000 to 2000, 1500 where the trim is (RCn_MIN, RCMAP_*)."""
    held = {str(row["Name"]): float(row["Value"]) for _, row in reversed(rows["PARM"])}
    for number, use in enumerate(("ROLL", "PITCH", "THROTTLE", "YAW"), start=1):
        channel = int(held.get(f"RCMAP_{use}", number))
        low, trim, high = (
            held.get(f"RC{channel}_{end}", usual) for end, usual in (("MIN", 1000.0), ("TRIM", 1500.0), ("MAX", 2000.0))
        )
        if number == 3:
            trim = (low + high) / 2
        if not low < trim < high:
            low, trim, high = 1000.0, 1500.0, 2000.0
        sign = -1.0 if held.get(f"RC{channel}_REVERSED", 0.0) == 1.0 else 1.0
        points = [(at, float(row[f"C{channel}"])) for at, row in rows["RCIN"] if row.get(f"C{channel}")]
        way = [(at, (pwm - trim) / (high - trim if pwm > trim else trim - low)) for at, pwm in points]
        _column(columns, f"rc{number}_pwm", [(at, 1500.0 + 500.0 * sign * share) for at, share in way])


def _modes(rows: dict[str, list[Row]], columns: Columns) -> None:
    """Add what follows from modes and mission: take-off items, the end of a parachute's absence, aims of CIRCLE."""
    items = [(at, float(row["CId"] == _NAV_TAKEOFF)) for at, row in rows["MISE"] if "CId" in row]
    flown = {int(row["ModeNum"]) for _, row in rows["MODE"] if "ModeNum" in row}
    if items:
        columns.hold("takeoff", *zip((0.0, 0.0), *items, strict=True))
    if flown and MODES["CIRCLE"] not in flown:
        for name in ("circle_radius_m", "circle_rate_dps"):
            columns.hold(name, [0.0], [0.0])  # as the signal says of all other modes
    if flown and not flown & {MODES["AUTO"], MODES["GUIDED"]}:
        columns.hold("takeoff", [0.0], [0.0])


def _events(rows: dict[str, list[Row]], formats: dict[str, str], columns: Columns) -> None:
    """Add what events and errors tell; a log that can hold them and does not hold one says that it did not happen."""
    courses: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for at, row in rows["EV"]:
        if row["Id"] in _EVENTS:
            signal, value = _EVENTS[row["Id"]]
            courses[signal].append((at, value))
    if any(row.get("Forced") for _, row in rows["ARM"]):
        courses["arming_forced"] = [(at, 1.0) for at, row in rows["ARM"] if row.get("Forced")]
    for at, row in rows["ERR"]:
        if row["Subsys"] in _FAILSAFES:
            courses[_FAILSAFES[row["Subsys"]]].append((at, float(row["ECode"] != 0)))
    if "EV" in formats or "ERR" in formats:
        for signal in {*_FAILSAFES.values(), "stop_ordered"} - courses.keys():
            columns.hold(signal, [0.0], [0.0])
    if courses["armed"] and not any(value == 0.0 for _, value in courses["landed"]):
        columns.hold("landed", *zip(*stands_by_height(columns, courses["armed"]), strict=True))
        del courses["landed"]
    for signal, points in courses.items():
        if points:
            columns.hold(signal, *zip((0.0, 1.0 - points[0][1]), *points, strict=True))
    lost = columns.get("failsafe_radio")
    if lost is not None and rows["RCIN"]:
        columns.hold("rc_present", lost[0], 1.0 - lost[1])
    add_taken_off(columns)
