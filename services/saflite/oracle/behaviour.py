"""In which way was a rule violated? What two finds must share to count as one behaviour, as far as one flight shows it.

Avoidance: the policy, how hard, which obstacle (in the order passed), on which side of it, on which leg of the mission;
the books compare the shapes of the tracks besides (`flight/track_shape.py`). Stimuli: the policy, how hard, the mode in
which it broke, and the inputs that may have caused it: those given before and not denied (names, without values; one
that was never answered may be what stopped the autopilot); for a death by a sanitizer also the place it reports. Places
and sizes of boxes, settings of the target and random seeds are no part of it: they are causes or noise, not behaviour.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import AUTOPILOT_ALIVE, Flight, given
from saflite.contract.ids import short_id
from saflite.contract.test_case import Obstacle, Scenario, TestCase
from saflite.contract.verdict import Verdict
from saflite.flight.geometry import boxes_array, distances_to_boxes
from saflite.flight.mission import waypoints
from saflite.oracle.signals import FlightSignals

REACHED_M = 3.0
"""A way-point counts as reached from the first moment it is so near in the plane."""

SANITIZER = "Sanitizer: "
"""What stands in the last words of an autopilot that a sanitizer ended; the rest names the place in its code."""

STEP_S = 0.5
Points = NDArray[np.float64]


def place_of(test_case: TestCase, signals: FlightSignals, closest: int) -> dict[str, float]:
    """Return how the nearest obstacle was passed, as features; `closest` is the sample of the least distance.

    closest_leg (from 1), closest_passed (its place in the order in which obstacles were passed, from 1), closest_side
    (1 left of it, -1 right of it, 0 over it).
    """
    points, boxes = signals.points(), test_case.scenario.obstacles
    stride = max(1, round(STEP_S / signals.step_s))
    row = closest // stride
    coarse = np.append(points[::stride][: row + 1], points[closest : closest + 1], axis=0)
    leg, course = _leg(test_case.scenario, coarse)
    each = distances_to_boxes(points[::stride], boxes_array(boxes))
    near = int(np.argmin(distances_to_boxes(points[closest : closest + 1], boxes_array(boxes))[0]))
    when = np.argmin(each, axis=0)
    passed = 1 + int(np.count_nonzero(when < when[near]))
    side = _side(boxes[near], points[closest], course)
    return {"closest_leg": float(leg), "closest_passed": float(passed), "closest_side": side}


def _leg(scenario: Scenario, track: Points) -> tuple[int, tuple[float, float]]:
    """Return the leg flown at the end of a track, from 1, and its direction; without a mission the track's own."""
    start, leg, row = (0.0, 0.0), 1, 0
    places = waypoints(scenario.mission) if scenario.mission is not None else ()
    for place in places:
        goal = place.x_m, place.y_m
        if math.dist(start, goal) <= REACHED_M:
            continue  # take-off
        near = np.flatnonzero(np.hypot(track[row:, 0] - goal[0], track[row:, 1] - goal[1]) < REACHED_M)
        if not len(near) or goal == (places[-1].x_m, places[-1].y_m):
            return leg, (goal[0] - start[0], goal[1] - start[1])
        start, leg, row = goal, leg + 1, row + int(near[0])
    return leg, (float(track[-1, 0] - track[0, 0]), float(track[-1, 1] - track[0, 1]))


def _side(box: Obstacle, point: Points, course: tuple[float, float]) -> float:
    """Return 1 where the vehicle passes left of the box seen along the course (x north, y east), -1 right, 0 over."""
    if point[2] > box.z_m + box.height_m:
        return 0.0
    across = course[0] * (point[1] - box.y_m) - course[1] * (point[0] - box.x_m)
    return -1.0 if across > 0 else 1.0


_SIDES = {1.0: "left of", -1.0: "right of", 0.0: "over"}


def behaviour_of(
    test_case: TestCase, verdict: Verdict, features: dict[str, float], signals: FlightSignals | None
) -> str:
    """Return in words the way in which a rule was violated; finds that differ in it are different behaviours."""
    parts = [verdict.policy, verdict.severity]
    if test_case.scenario.obstacles and "closest_leg" in features:
        side = _SIDES[features["closest_side"]]
        parts.append(f"{side} obstacle {features['closest_passed']:.0f} on leg {features['closest_leg']:.0f}")
    if test_case.stimuli or not test_case.scenario.obstacles:
        parts.append(f"in mode {_mode(verdict, signals)}")
    if verdict.policy == AUTOPILOT_ALIVE and SANITIZER in verdict.message:
        parts.append(verdict.message.partition(SANITIZER)[2])
    return ", ".join(parts)


def _mode(verdict: Verdict, signals: FlightSignals | None) -> int:
    if signals is None or "mode" not in signals or not signals.samples:
        return -1
    at = min(signals.samples - 1, max(0, round(verdict.witness_from_s / signals.step_s)))
    mode = float(signals["mode"][at])
    return int(mode) if math.isfinite(mode) else -1


def cause_of(test_case: TestCase, flight: Flight, verdict: Verdict) -> tuple[str, ...]:
    """Return the inputs that may have caused a violation: given before it ended and not denied, by kind and name."""
    died = verdict.policy == AUTOPILOT_ALIVE and flight.delivered is not None  # then all that was given came before
    until_s = math.inf if died else verdict.witness_to_s
    before = {
        f"{stimulus.kind} {stimulus.name}"
        for stimulus, answer, _ in given(test_case.stimuli, flight.delivered)
        if answer != "denied" and stimulus.at_s <= until_s
    }
    return tuple(sorted(before))


def fingerprint(verdict: Verdict) -> str:
    """Return a stable name of 16 hexadecimal digits for what one flight shows of a violation."""
    return short_id("\x1f".join((verdict.behaviour, *verdict.cause)).encode())
