"""Messages of an ArduPilot log by kind, as rows of time and fields: of sensors, batteries and filters those in use.

Names of fields are those of ArduCopter 3.2 to 4.7. A row in the middle of damage may hold any time and any number.
"""

from __future__ import annotations

import math
import struct
import tempfile
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.outside import LOG_BYTES_MAX, read_bytes
from saflite.flight.logs.dataflash_damage import HEAD, sound
from saflite.flight.logs.resample import DURATION_MAX_S, check_no_other_flight, told_far_off

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
    "VIBE",
    "GUID",
    "GUIP",
    "GUIA",
    "TERR",
)
_FILTERS = ("XKF1", "NKF1", "EKF1", "XKF4", "NKF4")
_INSTANCES = ("GPS", "BARO", "BAT", "CURR")
_WANTED = (*_PLAIN, *_FILTERS, *_INSTANCES, "GPS2")
ROWS_MAX = 5_000_000
"""Four hours of all that is read at 14 a second each. One takes half a kilobyte."""

FIX_3D = 3
_INSTANCE = ("I", "Instance", "Inst", "C")  # names of the field that counts them, over the releases

_SMALLER_UNITS = {("CURR", "Volt"): 0.01, ("CTUN", "ThrOut"): 0.001}
_WHOLE = frozenset("bBhHiI")
_TIMES = frozenset({"TimeUS", "TimeMS"})

Row = tuple[float, dict[str, Any]]
Rows = dict[str, list[Row]]


class Load(NamedTuple):
    """The rows of each kind in the order of the log, by kind the format letters of its fields, and what was lost."""

    rows: Rows
    formats: dict[str, str]
    lost: tuple[str, ...] = ()


def load(path: Path) -> Load:
    """Return what an ArduPilot log holds of what we read; raises Refused if it is none, or damaged beyond reading."""
    rows: Rows = defaultdict(list)
    try:
        data = read_bytes(path, "ArduPilot log", LOG_BYTES_MAX)
        if not data.startswith(HEAD):
            start = data[: len(HEAD)]
            raise Refused(
                "ArduPilot log",
                where=str(path),
                expected="a dataflash log",
                got=f"{start!r} at its start" if start else "an empty file",
            )
        log, lost = sound(data, str(path))
        left = ROWS_MAX
        with _reader(log) as reader:
            formats = {kind.name: kind for kind in reader.formats.values()}
            time_s = _clock(formats)
            while (message := reader.recv_match(type=list(_WANTED))) is not None:
                rows[message.get_type()].append((time_s(message), message.to_dict()))
                left -= 1
                if left < 0:
                    expected = f"at most {ROWS_MAX} messages of what is read"
                    raise Refused("ArduPilot log", where=str(path), expected=expected, got="more")
    except (OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, struct.error) as fault:
        raise Refused("ArduPilot log", where=str(path), expected="a whole dataflash log", got=repr(fault)) from fault
    _begin_with_the_clock(rows)
    _in_whole_units(rows, formats)
    lost += _leave_out_damage(rows)
    rows["GPS"] = _used_receiver(rows)
    for kind in ("BAT", "CURR"):
        rows[kind] = _of(rows[kind], lowest(rows[kind]))
    primary = next((value for _, name, value in settings_told(rows) if name in ("BARO_PRIMARY", "GND_PRIMARY")), 0.0)
    rows["BARO"] = _of(rows["BARO"], primary) or _of(rows["BARO"], lowest(rows["BARO"]))
    for kind in ("XKF", "NKF"):
        rows[f"{kind}1"] = _of_primary(rows[f"{kind}1"], rows[f"{kind}4"])
    return Load(rows, {name: kind.format for name, kind in formats.items()}, lost)


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


def _in_whole_units(rows: Rows, formats: dict[str, Any]) -> None:
    """Turn into volts and fractions what releases up to 3.3 logged as whole numbers of a smaller unit."""
    for (kind, field), unit in _SMALLER_UNITS.items():
        told = formats.get(kind)
        if told is None or field not in told.columns or told.format[told.columns.index(field)] not in _WHOLE:
            continue
        for _, fields in rows[kind]:
            if field in fields:
                fields[field] *= unit


def _clock(formats: dict[str, Any]) -> Callable[[Any], float]:
    """Return how to tell a row's time: by TimeUS where all have it, else by the clock the library makes of the log.

    That clock runs from the first row with a time of its own on: NaN before.
    """
    if all("TimeUS" in kind.columns for name, kind in formats.items() if name in _WANTED):
        return lambda message: float(message.TimeUS) / 1e6
    runs = False

    def told(message: Any) -> float:
        nonlocal runs
        runs = runs or not _TIMES.isdisjoint(message.get_fieldnames())
        return float(message._timestamp) if runs else math.nan

    return told


def _begin_with_the_clock(rows: Rows) -> None:
    """Have what stands before the first row with a time (the mode and the event of arming do) happen then, or at 0."""
    first_s = min((at_s for told in rows.values() for at_s, _ in told if not math.isnan(at_s)), default=0.0)
    for kind, told in rows.items():
        rows[kind] = [(first_s if math.isnan(at_s) else at_s, fields) for at_s, fields in told]


def _leave_out_damage(rows: Rows) -> tuple[str, ...]:
    """Drop rows whose time is further from most of the log than any flight lasts; return in words how many.

    Raises ValueError where they are another flight.
    """
    times = [at_s for told in rows.values() for at_s, _ in told]
    middle_s = median(times) if times else 0.0
    for kind, told in rows.items():
        at_s = np.array([row[0] for row in told])
        far = ~(np.abs(at_s - middle_s) <= DURATION_MAX_S)
        check_no_other_flight(kind, at_s, far)
        rows[kind] = [row for row, is_far in zip(told, far, strict=True) if not is_far]
    dropped = len(times) - sum(map(len, rows.values()))
    return (told_far_off(dropped),) if dropped else ()


def _used_receiver(rows: Rows) -> list[Row]:
    """Return the rows of the receiver in use (GPS.U); where the log does not say, of the one with the most fixes."""
    both = sorted(rows["GPS"] + rows["GPS2"], key=lambda row: row[0])
    used = [row for row in both if row[1].get("U") in (1, "1")]
    if used:
        return used
    apart = defaultdict[float, list[Row]](list)
    for row in rows["GPS"]:
        apart[_instance(row[1])].append(row)
    receivers = [*(apart[number] for number in sorted(apart)), rows["GPS2"]]
    return max(receivers, key=lambda told: sum(status >= FIX_3D for _, status in points(told, "Status")))


def _instance(fields: dict[str, Any]) -> float:
    value = next((fields[name] for name in _INSTANCE if name in fields), 0)
    return float(value) if str(value).isdecimal() else 0.0


def lowest(rows: list[Row]) -> float:
    """Return the lowest number among those of sensors or monitors that rows are of, from 0."""
    return min((_instance(fields) for _, fields in rows), default=0.0)


def _of(rows: list[Row], number: float) -> list[Row]:
    return [row for row in rows if _instance(row[1]) == number]


def _of_primary(rows: list[Row], health: list[Row]) -> list[Row]:
    """Return the rows of the filter's core in use: each says in its health (XKF4, NKF4) which that is (PI)."""
    course = points(health, "PI")
    cores = {_instance(fields) for _, fields in rows}
    if len(cores) < 2:
        return rows
    chosen = [row for row in rows if _instance(row[1]) == held_at(course, row[0])]
    return chosen or _of(rows, lowest(rows))


@contextmanager
def _reader(log: bytes) -> Iterator[Any]:
    """Open the library's reader, which takes files only."""
    from pymavlink import DFReader

    with tempfile.NamedTemporaryFile(prefix="saflite-", suffix=".bin") as file:
        file.write(log)
        file.flush()
        with DFReader.DFReader_binary(file.name) as reader:
            yield reader
