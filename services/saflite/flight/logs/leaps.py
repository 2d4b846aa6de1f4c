"""Where the estimate of a log leaps: the vehicle did not move then, its autopilot corrected where it takes it to be.

PX4 counts its resets, ArduPilot tells of lane switches and of some resets; any other shows as a place that no speed
told leads to. A reset is a leap by its size only, told or seen: an estimator in trouble resets speeds, and places by
millimetres, time and again, while the vehicle does drift. What holds a place or height is compared with where it is
held from then on, as autopilots shift their aim along: `gps_settled`, `baro_settled` and `body_true` are 0 about a leap
of place, height and heading.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.flight.logs.dataflash_rows import Rows, points
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.topics import Topics, field

Array = NDArray[np.float64]
_SHOWN = {"gps_settled": ("x_m", "y_m"), "baro_settled": ("altitude_m",), "body_true": ()}
_SEEN = {**_SHOWN, "body_true": ("yaw_deg",)}
_SPEEDS = {"x_m": "vx_mps", "y_m": "vy_mps", "altitude_m": "climb_mps", "yaw_deg": "yaw_rate_dps"}
_LEAP_M = 1.0  # farther from where its speed leads
_APART_S = 0.25  # between samples farther apart the speed may have been another
_BEFORE_S, _AFTER_S = 0.5, 1.0  # an event may be told late; until speeds and aims have followed
_LEAST = {"gps_settled": 0.3, "baro_settled": 0.3, "body_true": 3.0}
"""Metres, degrees: a smaller reset takes nothing out of its place."""
_COUNTERS: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    "vehicle_local_position": {
        "gps_settled": ("xy_reset_counter", ("delta_xy[0]", "delta_xy[1]")),
        "baro_settled": ("z_reset_counter", ("delta_z",)),
        "body_true": ("heading_reset_counter", ("delta_heading",)),
    },
    "vehicle_global_position": {
        "gps_settled": ("lat_lon_reset_counter", ()),
        "baro_settled": ("alt_reset_counter", ("delta_alt",)),
    },
    "vehicle_attitude": {"body_true": ("quat_reset_counter", tuple(f"delta_q_reset[{part}]" for part in range(4)))},
}
"""Of each topic, by what is not settled then: what counts resets of it, and by how much the last one changed it."""
_EVENTS = {60.0: "baro_settled", 62.0: "body_true"}  # EKF_ALT_RESET, EKF_YAW_RESET
_HEALTH = ("XKF4", "NKF4")
_RATIOS = {"SV": "gps_settled", "SP": "gps_settled", "SM": "body_true"}
"""Of the health of a filter: how far speed, position and compass are off, by what the failsafe is raised."""
_THRESHOLD = 0.8  # FS_EKF_THRESH as it is delivered


class _Leap(NamedTuple):
    """It leapt between these times, seconds; told by what is not settled about it."""

    flag: str
    from_s: float
    to_s: float


def add_leaps_of_px4(topics: Topics, columns: Columns) -> None:
    """Add where the counters of resets count on, by as much as they tell or as is seen, or a place leaps."""
    found = []
    for name, flags in _COUNTERS.items():
        for flag, (counter, deltas) in flags.items():
            column = field(topics, name, counter)
            if column is not None:
                told = [delta[1] for one in deltas if (delta := field(topics, name, one)) is not None]
                size = _size(flag, told) if told and len(told) == len(deltas) else None
                found += _large(columns, _changes(flag, *column), size)
    _add(columns, found)


def _size(flag: str, deltas: list[Array]) -> Array:
    """Return by how much resets changed a place or height, metres, or an attitude, degrees; shape (n,)."""
    if flag != "body_true":
        return np.asarray(np.linalg.norm(deltas, axis=0), dtype=np.float64)
    turned = deltas[0] if len(deltas) == 1 else 2 * np.arctan2(np.linalg.norm(deltas[1:], axis=0), np.abs(deltas[0]))
    return np.asarray(np.abs(np.degrees(turned)), dtype=np.float64)


def add_leaps_of_ardupilot(rows: Rows, held: Mapping[str, float], columns: Columns) -> None:
    """Add where another core of the filter is taken, a reset is told, or a place leaps.

    As little is settled while the filter itself distrusts what it is given (FS_EKF_THRESH): its failsafe has a cause.
    """
    events = [(at_s, _EVENTS[number]) for at_s, number in points(rows["EV"], "Id") if number in _EVENTS]
    found = _large(columns, [(_Leap(flag, at_s - _BEFORE_S, at_s), 0) for at_s, flag in events])
    for kind in _HEALTH:
        for core, flags in (("PI", tuple(_SHOWN)), ("OFN", ("gps_settled",)), ("OFE", ("gps_settled",))):
            told = points([row for row in rows[kind] if core == "PI" or not row[1].get("C", 0)], core)
            if told:
                at_s, values = np.array(told).T
                size = None if core == "PI" else np.abs(np.diff(values, prepend=values[0]))
                for flag in flags:
                    found += _large(columns, _changes(flag, at_s, values), size)
        threshold = held.get("FS_EKF_THRESH", _THRESHOLD) or _THRESHOLD
        for ratio, flag in _RATIOS.items():
            told = points([row for row in rows[kind] if not row[1].get("C", 0)], ratio)
            found += [_Leap(flag, at_s, at_s + _AFTER_S) for at_s, value in told if value >= threshold]
    _add(columns, found)


def _changes(flag: str, at_s: Array, values: Array) -> list[tuple[_Leap, int]]:
    """Return between which rows something told changes, and the number of the latter."""
    rows = np.flatnonzero(np.diff(values)) + 1
    return [(_Leap(flag, float(at_s[row - 1]), float(at_s[row])), int(row)) for row in rows]


def _large(columns: Columns, changes: list[tuple[_Leap, int]], size: Array | None = None) -> list[_Leap]:
    """Return the changes that are leaps by their size, told by row or, where None, seen in the estimate."""
    if size is not None:
        return [one for one, row in changes if size[row] > _LEAST[one.flag]]
    names = {name for one, _ in changes for name in _SEEN[one.flag]}
    seen = {name: found for name in names if (found := _unexplained(columns, name)) is not None}
    return [one for one, _ in changes if any(_is_seen(one, *seen[name]) for name in _SEEN[one.flag] if name in seen)]


def _is_seen(leap: _Leap, at_s: Array, off: Array) -> bool:
    """Return whether an estimate told `at_s` goes elsewhere than its speed says between the samples about a leap."""
    first, last = np.searchsorted(at_s, leap.from_s, side="right") - 1, np.searchsorted(at_s, leap.to_s)
    return bool((off[max(0, first) : max(last, 1)] > _LEAST[leap.flag]).any())


def _add(columns: Columns, told: list[_Leap]) -> None:
    for flag, names in _SHOWN.items():
        leaps = [one for one in told if one.flag == flag]
        leaps += [_Leap(flag, *span) for name in names for span in _unmoved(columns, name)]
        if leaps:
            spans = _joined((one.from_s, one.to_s + _AFTER_S) for one in leaps)
            columns.hold(flag, [0.0, *chain(*spans)], [1.0, *[0.0, 1.0] * len(spans)])
    columns.height_leaps = _unmoved(columns, "altitude_m")


def _joined(spans: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return spans of time in order, those that meet as one."""
    found: list[tuple[float, float]] = []
    for from_s, to_s in sorted(spans):
        if found and from_s <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], to_s)
        else:
            found.append((from_s, to_s))
    return found


def _unmoved(columns: Columns, name: str) -> list[tuple[float, float]]:
    """Return between which samples a place changes as no speed told would have it."""
    found = _unexplained(columns, name) if _SPEEDS[name] in columns else None
    if found is None:
        return []
    at_s, off_m = found
    leapt = np.flatnonzero((off_m > _LEAP_M) & (np.diff(at_s) <= _APART_S))
    return [(float(at_s[one]), float(at_s[one + 1])) for one in leapt]


def _unexplained(columns: Columns, name: str) -> tuple[Array, Array] | None:
    """Return when an estimate was told, shape (n,), and how far each step is off what its speed explains, (n - 1,)."""
    place, speed = columns.get(name), columns.get(_SPEEDS[name])
    if place is None:
        return None
    at_s, values = place[0], np.unwrap(place[1], period=360.0) if name == "yaw_deg" else place[1]
    course = np.zeros(len(at_s)) if speed is None else np.interp(at_s, *speed)
    return at_s, np.abs(np.diff(values) - np.diff(at_s) * (course[1:] + course[:-1]) / 2)
