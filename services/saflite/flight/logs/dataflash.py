"""ArduPilot flight logs (`.bin`) as traces, through pymavlink: estimate, attitude, modes, events, failsafes, sticks."""

from __future__ import annotations

import struct
from collections import defaultdict
from pathlib import Path
from typing import Any

from saflite.contract.errors import Refused
from saflite.contract.flight import Trace
from saflite.flight.logs.resample import Columns
from saflite.flight.mission import to_local

_HEAD = b"\xa3\x95"
_ESTIMATORS = ("XKF1", "NKF1")
_WANTED = (*_ESTIMATORS, "POS", "ATT", "RATE", "MODE", "EV", "ERR", "GPS", "BARO", "RCIN", "BAT", "CTUN", "MSG")
_FIELDS: dict[str, dict[str, str]] = {
    "ATT": {"Roll": "roll_deg", "Pitch": "pitch_deg", "Yaw": "yaw_deg"},
    "RATE": {"R": "roll_rate_dps", "P": "pitch_rate_dps", "Y": "yaw_rate_dps"},
    "MODE": {"ModeNum": "mode"},
    "GPS": {"NSats": "gps_satellites"},
    "BARO": {"Alt": "baro_altitude_m"},
    "RCIN": {f"C{number}": f"rc{number}_pwm" for number in range(1, 5)},
    "BAT": {"Volt": "battery_v"},
    "CTUN": {"DAlt": "altitude_target_m", "ThO": "throttle"},
}
_EVENTS: dict[int, tuple[str, float]] = {
    10: ("armed", 1.0),
    11: ("armed", 0.0),
    18: ("landed", 1.0),
    28: ("landed", 0.0),
    51: ("chute_released", 1.0),
}
_FAILSAFES: dict[int, str] = {
    5: "failsafe_radio",
    6: "failsafe_battery",
    7: "failsafe_gps",
    9: "failsafe_fence",
    17: "failsafe_gps",
}
_FIX_3D = 3

Row = tuple[float, dict[str, Any]]


def read_dataflash(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in an ArduPilot log.

    Raises:
        Refused: the file is missing, is no dataflash log, is damaged, or lacks a position (if `placed`) or all signals.
    """
    rows = _load(path)
    columns = Columns()
    _position(rows, columns)
    for kind, fields in _FIELDS.items():
        for field, signal in fields.items():
            _column(columns, signal, [(at, row[field]) for at, row in rows[kind] if field in row])
    _column(columns, "gps_ok", [(at, float(row["Status"] >= _FIX_3D)) for at, row in rows["GPS"] if "Status" in row])
    _events(rows, columns)
    columns.messages = [(at, str(row.get("Message", "")), "info") for at, row in rows["MSG"]]
    return columns.trace("ArduPilot log", str(path), placed=placed)


def _load(path: Path) -> dict[str, list[Row]]:
    from pymavlink import DFReader

    rows: dict[str, list[Row]] = defaultdict(list)
    try:
        with path.open("rb") as file:
            start = file.read(len(_HEAD))
        if start != _HEAD:
            raise Refused("ArduPilot log", where=str(path), expected="a dataflash log", got=f"{start!r} at its start")
        log = DFReader.DFReader_binary(str(path))
        while (message := log.recv_match(type=list(_WANTED))) is not None:
            kind, fields = message.get_type(), message.to_dict()
            if fields.get("C", fields.get("I", 0)) in (0, "0") or kind not in (*_ESTIMATORS, "GPS", "BARO", "BAT"):
                rows[kind].append((fields.get("TimeUS", message._timestamp * 1e6) / 1e6, fields))
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error) as fault:
        raise Refused("ArduPilot log", where=str(path), expected="a whole dataflash log", got=repr(fault)) from fault
    return rows


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


def _events(rows: dict[str, list[Row]], columns: Columns) -> None:
    courses: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for at, row in rows["EV"]:
        if row["Id"] in _EVENTS:
            signal, value = _EVENTS[row["Id"]]
            courses[signal].append((at, value))
    for at, row in rows["ERR"]:
        if row["Subsys"] in _FAILSAFES:
            courses[_FAILSAFES[row["Subsys"]]].append((at, float(row["ECode"] != 0)))
    for signal, points in courses.items():
        _column(columns, signal, [(0.0, 1.0 - points[0][1]), *points])
