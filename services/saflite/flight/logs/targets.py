"""Targets that a companion computer streams: orders that are no commands, and speeds that are no settings.

In ArduCopter's GUIDED and in PX4's offboard mode messages of MAVLink (SET_POSITION_TARGET_LOCAL_NED and the like) say
where to go, how fast or at which lean, many times a second. ArduCopter logs each (GUID up to 4.1, GUIP and GUIA since)
with a number that says what it is of; PX4 stays in offboard for as long as they come. Where they tell more than a place
the vehicle flies by them, whatever the speeds of autonomous modes are set to.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Stimulus
from saflite.flight.logs.dataflash_rows import Rows
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.topics import Topics, field, held

ORDER = "SET_POSITION_TARGET_LOCAL_NED"
_SPEEDS = ("cruise_speed_set_mps", "takeoff_speed_set_mps", "descent_speed_set_mps")
_OWN_SPEED = {"GUIP": 3, "GUID": 2, "GUIA": 0}  # from that number on: speed, acceleration, lean; below: places
_PLACE_OR_MORE = 2  # of a GUID with accelerations (from 4.1 on): a place, in some builds with a speed
_MORE = ("vX", "vY", "vZ", "aX", "aY", "aZ")
_OFFBOARD = 14  # vehicle_status.NAVIGATION_STATE_OFFBOARD
_APART_S, _ORDERS_MAX = 1.0, 5_000  # between orders: they stand for a stream, of a long one for more of it each
_SAME_S = 0.3  # what a command orders is logged as a target, too

Span = tuple[float, float]
Times = NDArray[np.float64]


def targets_of_ardupilot(rows: Rows, columns: Columns) -> list[Stimulus]:
    """Return the targets as orders, and have the speeds set not be known where others are flown."""
    told = sorted((at_s, _tells_more(kind, row)) for kind in _OWN_SPEED for at_s, row in rows[kind] if "Type" in row)
    ends_s = [at_s for at_s, _ in rows["MODE"]]
    marks = sorted([*told, *((at_s, False) for at_s in ends_s)])
    spans, since_s = list[Span](), None
    for at_s, own in marks:
        if own and since_s is None:
            since_s = at_s
        elif not own and since_s is not None:
            spans.append((since_s, at_s))
            since_s = None
    if since_s is not None:
        spans.append((since_s, np.inf))
    _forget(columns, spans)
    ordered_s = np.array(sorted(at_s for at_s, _ in rows["MAVC"]))
    told_s = np.array([at_s for at_s, _ in told])
    near = _near(ordered_s, told_s)
    return _orders(at_s for (at_s, own), by_command in zip(told, near, strict=True) if own or not by_command)


def _tells_more(kind: str, row: Mapping[str, Any]) -> bool:
    """Return whether a target tells more than a place.

    From 4.1 on GUID tells accelerations, and has the numbers of GUIP, at first without that of places sent as such.
    """
    number = int(row["Type"])
    if kind == "GUID" and "aX" in row and number == _PLACE_OR_MORE:
        return any(row.get(name) for name in _MORE)
    return number >= _OWN_SPEED[kind]


def targets_of_px4(topics: Topics, columns: Columns) -> list[Stimulus]:
    """Return the orders that offboard mode stands for, and have the speeds set not be known in it."""
    state = field(topics, "vehicle_status", "nav_state")
    if state is None or not len(state[0]):
        return []
    flags = np.concatenate([[False], state[1] == _OFFBOARD, [False]])
    begin, end = (np.flatnonzero(np.diff(flags.astype(np.int8)) == step) for step in (1, -1))
    last_s = max((float(topic["timestamp"][-1]) / 1e6 for topic in topics.values()), default=0.0)
    ends_s = np.append(state[0], np.inf)
    spans = [(float(state[0][first]), float(ends_s[after])) for first, after in zip(begin, end, strict=True)]
    _forget(columns, spans)
    bounded = [(since_s, min(until_s, last_s)) for since_s, until_s in spans]
    apart_s = max(_APART_S, sum(until_s - since_s for since_s, until_s in bounded) / _ORDERS_MAX)
    return _orders(at_s for since_s, until_s in bounded for at_s in np.arange(since_s, until_s, apart_s))


def _orders(times_s: Iterable[float]) -> list[Stimulus]:
    found: list[Stimulus] = []
    told_s = list(times_s)
    apart_s = max(_APART_S, (told_s[-1] - told_s[0]) / _ORDERS_MAX) if told_s else _APART_S
    for at_s in told_s:
        if not found or at_s >= found[-1].at_s + apart_s - 1e-6:
            found.append(Stimulus(at_s=float(at_s), kind="command", name=ORDER))
    return found


def _near(times_s: Times, asked_s: Times) -> NDArray[np.bool_]:
    """Return which of the moments asked for have one of the others, which ascend, close to them."""
    around = np.concatenate([[-np.inf], times_s, [np.inf]])
    after = np.clip(np.searchsorted(around, asked_s), 1, len(around) - 1)
    return np.asarray(np.minimum(asked_s - around[after - 1], around[after] - asked_s) <= _SAME_S)


def _forget(columns: Columns, spans: list[Span]) -> None:
    """Have the speeds set not be known within spans of time."""
    for name in _SPEEDS:
        course = columns.get(name)
        if course is None or not spans:
            continue
        begins, ends = (np.array(side) for side in zip(*spans, strict=True))  # they follow each other
        times = np.union1d(course[0], [*begins, *ends[np.isfinite(ends)]])
        inside = np.searchsorted(begins, times, side="right") > np.searchsorted(ends, times, side="right")
        columns.hold(name, times, np.where(inside, np.nan, held(course, times)))
