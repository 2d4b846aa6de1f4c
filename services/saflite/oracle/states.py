"""The steps of a flight through the target's states: mode, standing, disarmed, failsafes raised.

A state is what the trace shows of them, in words: `LOITER`, `RTL radio`, `STABILIZE standing disarmed`. Failsafes are
those of the common names: a target's own signals may show how one is set. Each input that was given and not denied
makes a step, from the state it was given in to the next one before the input after it (the same state where nothing
changed); every further change is a step without input.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Flight
from saflite.contract.signals import FAILSAFES, MODES, UNNAMED_MODE
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import TRANSITIONS_MAX, Transition
from saflite.oracle.signals import FlightSignals

FAILSAFE = "failsafe_"
_MODE_NAMES = {number: name for name, number in MODES.items()}


class Stretch(NamedTuple):
    """A state and the first sample it holds at."""

    state: str
    first: int


class Step(NamedTuple):
    """An input of the test case by its place, and the last sample before it."""

    stimulus: int
    sample: int


def transitions_of(test_case: TestCase, flight: Flight, signals: FlightSignals) -> tuple[Transition, ...]:
    """Return the steps of a flight in order, at most TRANSITIONS_MAX; none where the trace shows no mode."""
    if "mode" not in signals.written or signals.samples == 0:
        return ()
    stretches = _stretches(signals)
    steps = _steps(test_case, flight, signals)
    return tuple(_walk(stretches, steps))[:TRANSITIONS_MAX]


def _walk(stretches: list[Stretch], steps: list[Step]) -> list[Transition]:
    """Merge inputs and changes in order of time; an input of one sample comes before the change it causes."""
    found: list[Transition] = []
    at, cause, preceding = 0, -1, -1
    for place, step in enumerate(steps):
        while at + 1 < len(stretches) and stretches[at + 1].first <= step.sample:
            found.append(Transition(stretches[at].state, stretches[at + 1].state, -1, preceding))
            at += 1
        until = steps[place + 1].sample if place + 1 < len(steps) else None
        cause, before = step.stimulus, stretches[at].state
        if at + 1 < len(stretches) and (until is None or stretches[at + 1].first <= until):
            at += 1
        found.append(Transition(before, stretches[at].state, cause, preceding))
        preceding = cause
    for now, after in zip(stretches[at:], stretches[at + 1 :], strict=False):
        found.append(Transition(now.state, after.state, -1, preceding))
    return found


def _stretches(signals: FlightSignals) -> list[Stretch]:
    names = ["mode", *(name for name in ("landed", "armed") if name in signals.written)]
    raised = sorted(signals.written & set(FAILSAFES))
    rows = np.stack([np.asarray(signals[name], dtype=np.float32) for name in (*names, *raised)])
    rows = np.nan_to_num(rows, nan=0.0)
    changed = np.flatnonzero((rows[:, 1:] != rows[:, :-1]).any(axis=0)) + 1
    found: list[Stretch] = []
    for first in (0, *changed.tolist()):
        state = _words(dict(zip((*names, *raised), rows[:, first], strict=True)))
        if not found or found[-1].state != state:
            found.append(Stretch(state, first))
    return found


def _words(values: dict[str, NDArray[np.float32]]) -> str:
    number = int(values["mode"])
    words = [_MODE_NAMES.get(number, f"{UNNAMED_MODE}{number}".replace("-", "minus_"))]  # states are plain words
    words += ["standing"] if values.get("landed", 0.0) else []
    words += [] if values.get("armed", 1.0) else ["disarmed"]
    words += [name.removeprefix(FAILSAFE) for name, value in values.items() if name.startswith(FAILSAFE) and value]
    return " ".join(words)


def _steps(test_case: TestCase, flight: Flight, signals: FlightSignals) -> list[Step]:
    """Return the inputs that may have caused something, in order of time."""
    last = signals.samples - 1
    if flight.delivered is None:
        told = [(one.at_s, place) for place, one in enumerate(test_case.stimuli)]
    else:
        told = [(one.at_s, one.index) for one in flight.delivered if one.answer not in ("denied", "timed_out")]
    told.sort(key=lambda pair: pair[0])
    samples = [min(max(0.0, np.floor(at_s / signals.step_s + 1e-6)), float(last)) for at_s, _ in told]
    return [Step(place, int(sample)) for sample, (_, place) in zip(samples, told, strict=True)]
