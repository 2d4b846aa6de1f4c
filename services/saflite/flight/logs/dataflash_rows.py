"""Messages of an ArduPilot log by kind, as rows of time and fields: of sensors, batteries and filters those in use.

Names of fields are those of ArduCopter 3.4 to 4.6. A row in the middle of damage may hold any time and any number.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from saflite.contract.errors import Refused
from saflite.flight.logs.resample import DURATION_MAX_S

_HEAD = b"\xa3\x95"
HEAD_BYTES = len(_HEAD) + 1  # and the number of the format
_PLAIN = (
    "POS",
    "ATT",
    "AHR2",
    "RATE",
    "MODE",
    "EV",
    "ERR",
    "RCIN",
    "CTUN",
    "MSG",
    "MISE",
    "MAVC",
    "PARM",
    "ARM",
    "ORGN",
)
_FILTERS = ("XKF1", "NKF1", "EKF1", "XKF4", "NKF4")
_INSTANCES = ("GPS", "BARO", "BAT", "CURR")
_WANTED = (*_PLAIN, *_FILTERS, *_INSTANCES, "GPS2")
_INSTANCE = ("I", "Instance", "Inst", "C")  # names of the field that counts them, over the releases

Row = tuple[float, dict[str, Any]]
Rows = dict[str, list[Row]]


class Load(NamedTuple):
    """The rows of each kind in the order of the log, and by kind the format letters of its fields."""

    rows: Rows
    formats: dict[str, str]


def load(path: Path) -> Load:
    """Return what an ArduPilot log holds of what we read; raises Refused if it is none, or damaged beyond reading."""
    rows: Rows = defaultdict(list)
    try:
        with path.open("rb") as file:
            start = file.read(len(_HEAD))
        if start != _HEAD:
            raise Refused(
                "ArduPilot log",
                where=str(path),
                expected="a dataflash log",
                got=f"{start!r} at its start" if start else "an empty file",
            )
        log = _reader()(str(path))
        formats = {kind.name: kind for kind in log.formats.values()}
        time_s = _clock(formats)
        while (message := log.recv_match(type=list(_WANTED))) is not None:
            rows[message.get_type()].append((time_s(message), message.to_dict()))
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error) as fault:
        raise Refused("ArduPilot log", where=str(path), expected="a whole dataflash log", got=repr(fault)) from fault
    _leave_out_damage(rows)
    rows["GPS"] = _used_receiver(rows)
    for kind in ("BARO", "BAT", "CURR"):
        rows[kind] = _of_lowest(rows[kind])
    for kind in ("XKF", "NKF"):
        rows[f"{kind}1"] = _of_primary(rows[f"{kind}1"], rows[f"{kind}4"])
    return Load(rows, {name: kind.format for name, kind in formats.items()})


def points(rows: list[Row], *names: str, scale: float = 1.0) -> list[tuple[float, float]]:
    """Return times and numbers of the first of these fields that a row has; rows without a number are left out."""
    found = []
    for at_s, fields in rows:
        value = next((fields[name] for name in names if name in fields), None)
        if isinstance(value, (int, float)):
            found.append((at_s, value * scale))
    return found


def settings_told(rows: Rows) -> list[tuple[float, str, float]]:
    """Return when each parameter was told, its name and value, in the order of the log."""
    told = [(at_s, str(fields.get("Name")), fields.get("Value")) for at_s, fields in rows["PARM"]]
    return [(at_s, name, float(value)) for at_s, name, value in told if isinstance(value, (int, float))]


def held_at(course: list[tuple[float, float]], at_s: float, before: float = 0.0) -> float:
    """Return what a course that keeps each value until the next says at a time."""
    place = bisect_right(course, at_s, key=lambda point: point[0])
    return course[place - 1][1] if place else before


def _clock(formats: dict[str, Any]) -> Callable[[Any], float]:
    """Return how to tell a row's time: by TimeUS where all have it, else by the clock the library makes of the log."""
    if all("TimeUS" in kind.columns for name, kind in formats.items() if name in _WANTED):
        return lambda message: float(message.TimeUS) / 1e6
    return lambda message: float(message._timestamp)


def _leave_out_damage(rows: Rows) -> None:
    """Drop rows whose time is further from most of the log than any flight lasts."""
    times = [at_s for told in rows.values() for at_s, _ in told]
    middle_s = median(times) if times else 0.0
    for kind, told in rows.items():
        rows[kind] = [row for row in told if abs(row[0] - middle_s) <= DURATION_MAX_S]


def _used_receiver(rows: Rows) -> list[Row]:
    """Return the rows of the receiver in use (GPS.U), of the first where the log does not say."""
    both = sorted(rows["GPS"] + rows["GPS2"], key=lambda row: row[0])
    used = [row for row in both if row[1].get("U") in (1, "1")]
    return used or _of_lowest(rows["GPS"])


def _instance(fields: dict[str, Any]) -> float:
    value = next((fields[name] for name in _INSTANCE if name in fields), 0)
    return float(value) if str(value).isdigit() else 0.0


def _of_lowest(rows: list[Row]) -> list[Row]:
    lowest = min((_instance(fields) for _, fields in rows), default=0.0)
    return [row for row in rows if _instance(row[1]) == lowest]


def _of_primary(rows: list[Row], health: list[Row]) -> list[Row]:
    """Return the rows of the filter's core in use: each says in its health (XKF4, NKF4) which that is (PI)."""
    course = points(health, "PI")
    cores = {_instance(fields) for _, fields in rows}
    if len(cores) < 2:
        return rows
    chosen = [row for row in rows if _instance(row[1]) == held_at(course, row[0])]
    return chosen or _of_lowest(rows)


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
