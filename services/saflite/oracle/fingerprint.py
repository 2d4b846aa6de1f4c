"""Which violation is it? Near-identical finds share a fingerprint; different ones must not.

Avoidance: the policy, which obstacle came too near (its cell of 5 m), on which side and where along the mission, and
the coarse layout of all obstacles (cells of 10 m). Stimuli: the policy, the mode in which it broke, the inputs that
were given before and not denied (names, without values; one that was never answered may be what stopped the
autopilot), and the settings of the target. Coarse cells overlap nothing: two finds a hair apart may fall into
neighbouring cells, so counts of distinct violations are slightly generous.
"""

from __future__ import annotations

import math

from saflite.contract.flight import AUTOPILOT_ALIVE, Flight, given
from saflite.contract.ids import short_id
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Verdict
from saflite.oracle.signals import FlightSignals

NEAR_CELL_M = 5.0
LAYOUT_CELL_M = 10.0
PROGRESS_CELLS = 8


def fingerprint(
    test_case: TestCase, flight: Flight, verdict: Verdict, features: dict[str, float], signals: FlightSignals | None
) -> str:
    """Return a stable name of 16 hexadecimal digits for the violation that `verdict` tells of."""
    parts: list[object] = [verdict.policy]
    if test_case.scenario.obstacles and "closest_obstacle" in features:
        parts += _place(test_case, features)
    if test_case.stimuli or not test_case.scenario.obstacles:
        parts += _cause(test_case, flight, verdict, signals)
    return short_id("\x1f".join(str(part) for part in parts).encode())


def _cell(value: float, size: float) -> int:
    return math.floor(value / size)


def _place(test_case: TestCase, features: dict[str, float]) -> list[object]:
    boxes = test_case.scenario.obstacles
    near = boxes[int(features["closest_obstacle"])]
    side = math.atan2(features["closest_y_m"] - near.y_m, features["closest_x_m"] - near.x_m)
    layout = sorted((_cell(box.x_m, LAYOUT_CELL_M), _cell(box.y_m, LAYOUT_CELL_M)) for box in boxes)
    return [
        (_cell(near.x_m, NEAR_CELL_M), _cell(near.y_m, NEAR_CELL_M)),
        round(side / (math.pi / 2)) % 4,
        _cell(features.get("closest_progress", 0.0), 1.0 / PROGRESS_CELLS),
        layout,
    ]


def _cause(test_case: TestCase, flight: Flight, verdict: Verdict, signals: FlightSignals | None) -> list[object]:
    died = verdict.policy == AUTOPILOT_ALIVE and flight.delivered is not None  # then all that was given came before
    until_s = math.inf if died else verdict.witness_to_s
    before = sorted(
        {
            (stimulus.kind, stimulus.name)
            for stimulus, answer, _ in given(test_case.stimuli, flight.delivered)
            if answer != "denied" and stimulus.at_s <= until_s
        }
    )
    mode = -1
    if signals is not None and "mode" in signals and signals.samples:
        at = min(signals.samples - 1, max(0, round(verdict.witness_from_s / signals.step_s)))
        mode = int(signals["mode"][at])
    settings = [
        (name, sorted(map(str, value)) if isinstance(value, list) else value)
        for name, value in sorted(test_case.target.settings.items())
    ]
    return [mode, before, settings]
