"""Drawing the values of an input over sizes as well as ranges: near the default, on a log scale, at an end, beyond."""

from __future__ import annotations

import math
from collections.abc import Iterable

import msgspec
import numpy as np

from saflite.contract.test_case import Stimulus
from saflite.mutator.operators import commands, values
from saflite.mutator.operators.inputs import Have, Input

Rng = np.random.Generator
DECADES = 3.0  # how far below its upper end a value on the log scale may lie
STICK_ENDS = 0.35  # more sticks at an end, where they do most
RANGED = ("parameter", "sensor_fault")  # the kinds that may lack a range
PAST_ENDS = 0.3  # share of those beyond it: a radio that fails, or is set up wrong
NEAR_DEFAULT, ON_LOG_SCALE = 0.3, 0.3
EXTREME = 0.15  # share of commands of which one number is negative, 0, tiny or huge
FIRST = (0, 1, 2, 3)  # the numbers that say most where nothing is known
ORDINALS = 4  # the first number of a command often says which of a few things to do
MODERATE, MODERATELY = 0.7, 4.0  # share of settings moved that are so many times their default, or less
PUSHED_FAR = 0.4  # share of values pushed at least half the way
PUSHED_LEAST = 0.1  # of the way to the end of the range
STEPS = (0.003, 0.3)  # local search: least and greatest change, as a share of the value or the range


def draw(rng: Rng, entry: Input, default: float | None, beyond: float) -> values.Values:
    """Return values for an input; a share `beyond` of bounded ones lies outside the valid range."""
    if entry.kind == "stick" and rng.random() < STICK_ENDS and math.isfinite(entry.high - entry.low):
        past = values.STICK_BEYOND * float(rng.random()) * (entry.high - entry.low) if rng.random() < PAST_ENDS else 0.0
        return (float(round(entry.low - past if rng.random() < 0.5 else entry.high + past)),)
    if entry.kind in ("mode", "stick") or entry.choices:
        return values.draw(rng, entry, beyond)
    if entry.kind == "command":
        return _command(rng, entry, beyond)
    if rng.random() < beyond or not math.isfinite(entry.high - entry.low):
        return values.draw(rng, entry, 1.0 if math.isfinite(entry.high - entry.low) else beyond)
    way = rng.random()
    if default and way < NEAR_DEFAULT:
        return (_fit(entry, default * 10.0 ** rng.uniform(-1.0, 1.0)),)
    if entry.high > 0.0 and way < NEAR_DEFAULT + ON_LOG_SCALE:
        return (_fit(entry, entry.high * 10.0 ** -rng.uniform(0.0, DECADES)),)
    return values.draw(rng, entry, 0.0)


def _command(rng: Rng, entry: Input, beyond: float) -> values.Values:
    """Return numbers that mean something where it is known; unused ones are mostly 0, as senders have it."""
    numbers = values.draw(rng, entry, beyond)
    if not numbers or not math.isnan(entry.low):
        return numbers
    known = commands.known(entry.name)
    if known:
        unused = numbers if rng.random() < beyond else (0.0,) * commands.COUNT
        drawn = commands.draw(rng, entry.name)
        numbers = tuple(spare if number is None else number for number, spare in zip(drawn, unused, strict=True))
    elif rng.random() < 0.5:
        numbers = (float(rng.integers(ORDINALS)), *numbers[1:])
    if beyond > 0.0 and rng.random() < EXTREME:
        places = [place for place in (commands.telling(entry.name) if known else FIRST) if place < len(numbers)]
        place = places[int(rng.integers(len(places)))] if places else 0
        numbers = (*numbers[:place], _extreme(rng, numbers[place]), *numbers[place + 1 :])
    return numbers


def _extreme(rng: Rng, value: float) -> float:
    """Return what a command's number should not be taken at unless it says so: the one or the other way out."""
    way = int(rng.integers(5))
    if way == 0:
        return 0.0
    if way == 1:
        return -abs(value) or -1.0
    low, high = ((2.0, 5.0), (0.0, 4.0), (-3.0, -0.5))[way - 2]
    size = values.neat(10.0 ** rng.uniform(low, high))
    return -size if way == 3 else size


def pushed(rng: Rng, entry: Input, default: float | None, sense: float) -> float:
    """Return a value well off the default, up or down: all sizes of the way to that end of the range alike, or far."""
    end = entry.high if sense > 0.0 else entry.low
    far = rng.random() < PUSHED_FAR
    share = float(rng.uniform(0.5, 1.0)) if far else math.exp(rng.uniform(math.log(PUSHED_LEAST), 0.0))
    base = default if default is not None else entry.low if sense > 0.0 else entry.high
    if not math.isfinite(base):
        return draw(rng, entry, default, 0.0)[0]
    if not math.isfinite(end):
        return values.neat(base + sense * share * max(1.0, 9.0 * abs(base)))
    return _fit(entry, base + share * (end - base))


def moved(rng: Rng, entry: Input, default: float | None) -> float:
    """Return a value of a setting off its default: mostly a few times smaller or greater, so that it acts in time."""
    if not default or entry.choices or rng.random() >= MODERATE:
        return draw(rng, entry, default, 0.0)[0]
    return _fit(entry, default * MODERATELY ** (rng.uniform(0.3, 1.0) * (1.0 if rng.random() < 0.5 else -1.0)))


def _fit(entry: Input, value: float) -> float:
    kept = min(max(value, entry.low), entry.high)
    return float(round(kept)) if entry.whole else values.neat(kept)


def has_range(entry: Input) -> bool:
    """Return whether what may be given is known: of settings and faults a range or choices, of the rest always."""
    return entry.kind not in RANGED or bool(entry.choices) or math.isfinite(entry.high - entry.low)


def in_range(have: Have, stimuli: Iterable[Stimulus]) -> tuple[Stimulus, ...]:
    """Return stimuli with settings, sticks and faults within their range; that of a pulse reaches past it."""
    return tuple(_in_range(have.get((one.kind, one.name)), one) for one in stimuli)


def _in_range(entry: Input | None, stimulus: Stimulus) -> Stimulus:
    if entry is None or entry.kind not in (*RANGED, "stick") or len(stimulus.values) != 1:
        return stimulus
    kept = values.within(entry, stimulus.values)
    return stimulus if kept == stimulus.values else msgspec.structs.replace(stimulus, values=kept)


def nudge(rng: Rng, entry: Input, stimulus: Stimulus) -> Stimulus:
    """Return a stimulus with its value moved by a step of any size, for local search around a near miss."""
    if entry.kind in ("mode", "command") or entry.choices or not stimulus.values:
        return msgspec.structs.replace(stimulus, values=values.jitter(rng, entry, stimulus.values))
    low, high = (math.log(share) for share in STEPS)
    value, share = stimulus.values[0], math.exp(rng.uniform(low, high))
    span = entry.high - entry.low
    scale = span if entry.kind == "stick" and math.isfinite(span) else max(abs(value), 1e-3)
    moved = value + share * scale * (1.0 if rng.random() < 0.5 else -1.0)
    return msgspec.structs.replace(stimulus, values=(float(round(moved)) if entry.whole else values.neat(moved),))
