"""Where the estimate of a log leaps: the vehicle did not move then, its autopilot corrected where it takes it to be.

PX4 counts its resets, ArduPilot tells of lane switches and of some resets; any other shows as a place that no speed
told leads to. What holds a place or height is compared with where it is held from then on, as autopilots shift their
aim along: `gps_settled`, `baro_settled` and `body_true` are 0 about a leap of place, height and heading.
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
_SPEEDS = {"x_m": "vx_mps", "y_m": "vy_mps", "altitude_m": "climb_mps"}
_LEAP_M = 1.0  # farther from where its speed leads
_APART_S = 0.25  # between samples farther apart the speed may have been another
_BEFORE_S, _AFTER_S = 0.5, 1.0  # an event may be told late; until speeds and aims have followed
_COUNTERS: dict[str, dict[str, tuple[str, ...]]] = {
    "vehicle_local_position": {
        "gps_settled": ("xy_reset_counter", "vxy_reset_counter"),
        "baro_settled": ("z_reset_counter", "vz_reset_counter"),
        "body_true": ("heading_reset_counter",),
    },
    "vehicle_global_position": {"gps_settled": ("lat_lon_reset_counter",), "baro_settled": ("alt_reset_counter",)},
    "vehicle_attitude": {"body_true": ("quat_reset_counter",)},
}
_EVENTS = {60.0: "baro_settled", 62.0: "body_true"}  # EKF_ALT_RESET, EKF_YAW_RESET
_HEALTH = ("XKF4", "NKF4")
_RESET_M = 0.01
_RATIOS = {"SV": "gps_settled", "SP": "gps_settled", "SM": "body_true"}
"""Of the health of a filter: how far speed, position and compass are off, by what the failsafe is raised."""
_THRESHOLD = 0.8  # FS_EKF_THRESH as it is delivered


class _Leap(NamedTuple):
    """It leapt between these times, seconds; told by what is not settled about it."""

    flag: str
    from_s: float
    to_s: float


def add_leaps_of_px4(topics: Topics, columns: Columns) -> None:
    """Add where the counters of resets count on, or a place leaps."""
    found = []
    for name, flags in _COUNTERS.items():
        for flag, counters in flags.items():
            told = [column for counter in counters if (column := field(topics, name, counter)) is not None]
            found += [leap for at_s, count in told for leap in _changes(flag, at_s, count)]
    _add(columns, found)


def add_leaps_of_ardupilot(rows: Rows, held: Mapping[str, float], columns: Columns) -> None:
    """Add where another core of the filter is taken, a reset is told, or a place leaps.

    As little is settled while the filter itself distrusts what it is given (FS_EKF_THRESH): its failsafe has a cause.
    """
    events = points(rows["EV"], "Id")
    found = [_Leap(_EVENTS[number], at_s - _BEFORE_S, at_s) for at_s, number in events if number in _EVENTS]
    for kind in _HEALTH:
        for core, flags in (("PI", tuple(_SHOWN)), ("OFN", ("gps_settled",)), ("OFE", ("gps_settled",))):
            told = points([row for row in rows[kind] if core == "PI" or not row[1].get("C", 0)], core)
            if told:
                at_s, values = np.array(told).T
                found += [leap for flag in flags for leap in _changes(flag, at_s, values)]
        threshold = held.get("FS_EKF_THRESH", _THRESHOLD) or _THRESHOLD
        for ratio, flag in _RATIOS.items():
            told = points([row for row in rows[kind] if not row[1].get("C", 0)], ratio)
            found += [_Leap(flag, at_s, at_s + _AFTER_S) for at_s, value in told if value >= threshold]
    _add(columns, found)


def _changes(flag: str, at_s: Array, values: Array) -> list[_Leap]:
    places = np.flatnonzero(np.abs(np.diff(values)) > _RESET_M)
    return [_Leap(flag, float(at_s[one]), float(at_s[one + 1])) for one in places]


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
    place, speed = columns.get(name), columns.get(_SPEEDS[name])
    if place is None or speed is None:
        return []
    (at_s, values), course = place, np.interp(place[0], *speed)
    apart_s = np.diff(at_s)
    off_m = np.abs(np.diff(values) - apart_s * (course[1:] + course[:-1]) / 2)
    leapt = np.flatnonzero((off_m > _LEAP_M) & (apart_s <= _APART_S))
    return [(float(at_s[one]), float(at_s[one + 1])) for one in leapt]
