"""What ArduPilot logs tell by events and errors: arming, standing, orders to stop the motors, failsafes, crashes.

Events and errors are those of ArduPilot's LogEvent and LogErrorSubsystem.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping

import numpy as np

from saflite.flight.logs.dataflash_rows import Row, Rows, held_at, points
from saflite.flight.logs.flight_log import Points, add_taken_off, stands_by_height
from saflite.flight.logs.hits import struck
from saflite.flight.logs.resample import Columns

_ARMED, _DISARMED, _NOT_LANDED = 10, 11, 28
_SAY_ARMED = (15, 17, 28, 57)  # armed for autonomous modes, may have landed, has left the ground, motors run
_SOON_S = 10.0  # after arming the motors run, for autonomous modes it is up to the pilot
_LANDINGS = (17, 18)
_EVENTS: dict[int, tuple[str, float]] = {
    18: ("landed", 1.0),
    28: ("landed", 0.0),
    51: ("chute_released", 1.0),
}
_EMERGENCY_STOP, _INTERLOCK = 54, 56
_MOTORS_MAY_RUN = (55, 57)  # the emergency stop is cleared, the interlock given back
_FAILSAFES: dict[int, str] = {
    5: "failsafe_radio",
    6: "failsafe_battery",
    7: "failsafe_gps",
    9: "failsafe_fence",
    12: "crashed",
    17: "failsafe_gps",
}
_IN_THE_AIR_M = 2.0
_JUST_S = 1e-6  # a disarm counts as a landing at once
_LOST_DEG, _BEYOND_DEG = 60.0, 15.0  # a lean that is lost, and one beyond ANGLE_MAX, which may be 80 degrees
_TURNS_OVER = (1.0, 14.0, 18.0, 28.0)  # ACRO, FLIP, THROW, TURTLE
_FALLS_S = 0.6  # from higher than that it takes longer to the ground


def add(rows: Rows, formats: Mapping[str, str], held: Mapping[str, float], columns: Columns) -> None:
    """Add what events and errors tell; a log that can hold them and does not hold one says that it did not happen."""
    courses: dict[str, Points] = defaultdict(list)
    events = points(rows["EV"], "Id")
    for at, number in events:
        if number in _EVENTS:
            signal, value = _EVENTS[int(number)]
            courses[signal].append((at, value))
    if events and "chute_released" not in courses:  # that would be among them, whatever else is logged
        columns.hold("chute_released", [0.0], [0.0])
    forced = [at for at, row in rows["ARM"] if row.get("Forced") and row.get("ArmState", 1) > 0]
    if forced:
        courses["arming_forced"] = [(at, 1.0) for at in forced]
    for at, row in rows["ERR"]:
        if row.get("Subsys") in _FAILSAFES:
            courses[_FAILSAFES[row["Subsys"]]].append((at, float(row.get("ECode", 1) != 0)))
    if "failsafe_fence" in courses:
        courses["failsafe_fence"] = _breaches(courses["failsafe_fence"])
    if "EV" in formats or "ERR" in formats:
        for signal in set(_FAILSAFES.values()) - courses.keys():
            columns.hold(signal, [0.0], [0.0])
    courses["armed"] = _arming(rows, events, held, "EV" in formats)
    if "EV" in formats or rows["ARM"]:
        courses["stop_ordered"] = _stops(events, rows["ARM"], courses["armed"])
    landed = _standing(events, courses["armed"], courses.pop("landed", []), columns)
    if landed:
        columns.hold("landed", *zip(*landed, strict=True))
    if "crashed" in columns or "crashed" in courses:
        courses["crashed"] = sorted([*courses["crashed"], *_falls(rows, courses["armed"], held, columns)])
        courses["crashed"] = _crashes(courses["crashed"], courses["armed"], landed, columns)
    for signal, course in courses.items():
        if course:
            columns.hold(signal, *zip(*_with_before(course), strict=True))
    lost = columns.get("failsafe_radio")
    if lost is not None and rows["RCIN"]:
        columns.hold("rc_present", lost[0], 1.0 - lost[1])
    add_taken_off(columns)


def _breaches(told: Points) -> Points:
    """Return when the fence was broken and when that was over.

    ArduCopter up to 4.5 says it is over at each look at a fence that stays broken; it is at the last before it is
    broken again.
    """
    later = [*(value for _, value in told[1:]), 1.0]
    return [one for one, following in zip(told, later, strict=True) if one[1] > 0 or following > 0]


def _arming(rows: Rows, events: Points, held: Mapping[str, float], can_tell: bool) -> Points:
    """Return when the motors were armed and disarmed.

    A log that is opened by arming (LOG_DISARMED is 0) may lose that event: what only happens armed says it as well.
    A log of what comes before, too, that tells neither says that they never were.
    """
    told = [(at, 1.0 if number == _ARMED else 0.0) for at, number in events if number in (_ARMED, _DISARMED)]
    told += [(at, float(state > 0)) for at, state in points(rows["ARM"], "ArmState")]
    if told:
        return sorted(told)
    logs_disarmed = held.get("LOG_DISARMED", 0.0) > 0.0
    implied_s = min((at for at, number in events if number in _SAY_ARMED), default=None)
    if implied_s is None:
        return [(0.0, 0.0)] if can_tell and logs_disarmed else []
    began_s = min(at for kind in rows.values() for at, _ in kind)
    return [(0.0 if not logs_disarmed and implied_s - began_s <= _SOON_S else implied_s, 1.0)]


def _stops(events: Points, arming: list[Row], armed: Points) -> Points:
    """Return when the motors were ordered to stop come what may: by a switch, or by a disarm that was forced.

    Every disarm takes the interlock as well: only where it is taken of motors that are armed somebody ordered it. An
    order counts until it is taken back, or the motors are armed again. Orders by command are told apart (MAVC).
    """
    motors = _with_before(armed) if armed else []
    interlocked = [at for at, number in events if number == _INTERLOCK and held_at(motors, at, 1.0) > 0]
    stopped = [at for at, number in events if number == _EMERGENCY_STOP]
    forced = [at for at, row in arming if row.get("Forced") and not row.get("ArmState", 1)]
    over = [at for at, number in events if number in _MOTORS_MAY_RUN] + [at for at, runs in armed if runs]
    orders = [(at, 1.0) for at in (*interlocked, *stopped, *forced)]
    return [(0.0, 0.0), *sorted([*orders, *((at, 0.0) for at in over)])]


def _falls(rows: Rows, armed: Points, held: Mapping[str, float], columns: Columns) -> Points:
    """Return where an armed vehicle that leant over farther than it may hit something; some modes may turn it over.

    A hit is an accelerometer at its end (VIBE counts these); the crash check looks at leans alone, and for two seconds.
    Who carries the vehicle about, disarmed, turns it over and lets it bump as well.
    """
    roll, pitch = columns.get("roll_deg"), columns.get("pitch_deg")
    if roll is None or pitch is None or not armed:
        return []
    modes, motors = points(rows["MODE"], "ModeNum", "Mode") or [(0.0, 0.0)], _with_before(armed)
    may_deg = held.get("ATC_ANGLE_MAX", held.get("ANGLE_MAX", 0.0) / 100)
    upright = np.cos(np.radians(roll[1])) * np.cos(np.radians(np.interp(roll[0], *pitch)))
    over = roll[0][upright <= np.cos(np.radians(max(_LOST_DEG, may_deg + _BEYOND_DEG)))]
    lost_s = [at for at in map(float, over) if held_at(motors, at) and held_at(modes, at) not in _TURNS_OVER]
    hits_s = [at for at in _hits(rows) if held_at(motors, at)]
    off_s = [*(at for at, runs in armed if not runs), float(roll[0][-1])]
    return [(float(at), 1.0) for at in struck(np.array(hits_s), np.array(lost_s), np.sort(off_s))[:1]]


def _hits(rows: Rows) -> list[float]:
    """Return when an accelerometer was at its end, for each that is fitted: up to 4.0 one row counts for all."""
    counted: dict[str, float] = {}
    hits = []
    for at, row in rows["VIBE"]:
        told = [row.get(name) for name in ("Clip", "Clip0", "Clip1", "Clip2")]
        which, count = str(row.get("IMU")), sum(one for one in told if isinstance(one, (int, float)))
        if count > counted.setdefault(which, count):
            hits.append(at)
        counted[which] = count
    return sorted(hits)


def _crashes(told: Points, armed: Points, landed: Points, columns: Columns) -> Points:
    """Return when it crashed; an autopilot looks out for that while armed: what comes of a disarm in the air is NaN."""
    height, course, ground_m = columns.get("altitude_m"), [(0.0, 0.0), *told], 0.0
    if height is None or not landed:
        return course
    for at_s, runs in armed:
        above_m = float(np.interp(at_s, *height)) - ground_m
        if runs:
            ground_m += above_m
            course += [(at_s, 0.0)] if math.isnan(course[-1][1]) else []
        elif above_m > _IN_THE_AIR_M and not held_at(landed, at_s - _JUST_S) and not held_at(told, at_s):
            course.append((at_s + _FALLS_S, math.nan))
    return sorted(course, key=lambda point: point[0])


def _standing(events: Points, armed: Points, landed: Points, columns: Columns) -> Points:
    """Return when the vehicle stood: by its events, or by its height where they do not say when it left the ground."""
    if not armed:
        return landed and _with_before(landed)
    first = next((number for _, number in events if number in (_ARMED, _NOT_LANDED, *_LANDINGS)), None)
    height = columns.get("altitude_m")
    if first in _LANDINGS and height is not None and height[1][0] > _IN_THE_AIR_M:
        return [(0.0, 0.0), *(landed or [(at, 1.0) for at, motors in armed if not motors])]
    if any(value == 0.0 for _, value in landed):
        return _with_before(landed)
    return stands_by_height(columns, armed)


def _with_before(course: Points) -> Points:
    """Return a course of flags from the log's beginning on: what is told first was otherwise before."""
    return course if course[0][0] == 0.0 else [(0.0, 1.0 - course[0][1]), *course]
