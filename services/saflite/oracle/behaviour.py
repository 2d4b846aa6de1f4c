"""In which way was a rule violated? What two finds must share to count as one behaviour, as far as one flight shows it.

Avoidance: the policy, how hard, which obstacle (in the order passed), on which side of it, on which leg of the mission;
the books compare the shapes of the tracks besides (`flight/track_shape.py`). Stimuli: the policy, how hard, the mode in
which it broke, and the inputs that may have caused it: those given before and not denied (names, without values; one
that was never answered may be what stopped the autopilot); for a death by a sanitizer also the place it reports. Places
and sizes of boxes, settings of the target and random seeds are no part of it: they are causes or noise, not behaviour.
"""

from __future__ import annotations

import math

from saflite.contract.flight import AUTOPILOT_ALIVE, Flight, given
from saflite.contract.ids import short_id
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Verdict
from saflite.flight.passing import Passing, passing_of
from saflite.oracle.signals import FlightSignals

SANITIZER = "Sanitizer: "
"""What stands in the last words of an autopilot that a sanitizer ended; the rest names the place in its code."""

STEP_S = 0.5


def place_of(test_case: TestCase, signals: FlightSignals, closest: int) -> dict[str, float]:
    """Return how the nearest obstacle was passed, as features; `closest` is the sample of the least distance.

    closest_leg (from 1), closest_passed (its place in the order in which obstacles were passed, from 1), closest_side
    (1 left of it, -1 right of it, 0 over it).
    """
    points, stride = signals.points(), max(1, round(STEP_S / signals.step_s))
    passing = passing_of(test_case.scenario, points[::stride], closest // stride, points[closest])
    return {
        "closest_leg": float(passing.leg),
        "closest_passed": float(passing.order),
        "closest_side": passing.side,
    }


def behaviour_of(
    test_case: TestCase, verdict: Verdict, features: dict[str, float], signals: FlightSignals | None
) -> str:
    """Return in words the way in which a rule was violated; finds that differ in it are different behaviours."""
    parts = [verdict.policy, verdict.severity]
    if test_case.scenario.obstacles and "closest_leg" in features:
        leg, order = round(features["closest_leg"]), round(features["closest_passed"])
        parts.append(str(Passing(leg, order, features["closest_side"])))
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
