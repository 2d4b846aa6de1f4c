"""Drawing the value of an input: PGFuzz's rules with their dead branches mended. Pure.

PGFuzz (NDSS 2021): a parameter evenly in its valid range, a least value only: up to 10,000; none known: always 0;
commands: seven whole numbers 1..100; sensors and world: 0..100. Mended here: inputs without bounds get numbers of every
size and sign instead of 0, a share of draws leaves the valid range (below, above, negative, 0), and commands get
numbers that mean something to them.
"""

from __future__ import annotations

import math

import numpy as np

from saflite.mutator.operators import commands
from saflite.mutator.operators.inputs import Input

Rng = np.random.Generator
Values = tuple[float, ...]

UNBOUNDED_HIGH = 10_000.0
STICK_BEYOND = 0.2  # how far beyond its ends a failing radio can put a stick, as a share of its range


def neat(value: float) -> float:
    """Return the number with six digits, so that it reads well and survives every text form."""
    return float(f"{value:.6g}")


def draw(rng: Rng, entry: Input, beyond: float) -> Values:
    """Return values for the input; a share `beyond` of bounded ones lies outside the valid range."""
    if entry.kind == "mode":
        return ()
    if entry.choices and rng.random() >= beyond:
        return (entry.choices[int(rng.integers(len(entry.choices)))],)
    if entry.kind == "command" and math.isnan(entry.low):
        return _command(rng, entry.name, beyond)
    if entry.kind == "stick" and math.isfinite(entry.high - entry.low):
        return (_stick(rng, entry, beyond),)
    if rng.random() < beyond:
        return (_beyond(rng, entry),)
    return (_within(rng, entry),)


def jitter(rng: Rng, entry: Input, values: Values) -> Values:
    """Return the values moved a little: by up to a tenth of the range, or of their size where there is none.

    A command's numbers are mostly choices, not sizes: one of them is drawn anew.
    """
    if entry.kind == "mode" or not values:
        return values
    if entry.choices:
        return draw(rng, entry, 0.2)
    if entry.kind == "command" and math.isnan(entry.low):
        places = [place for place in commands.used(entry.name) if place < len(values)] or range(len(values))
        place, new = places[int(rng.integers(len(places)))], _command(rng, entry.name, 0.2)
        return (*values[:place], new[place], *values[place + 1 :])
    span = entry.high - entry.low
    moved = []
    for value in values:
        reach = 0.1 * span if math.isfinite(span) else 0.1 * max(1.0, abs(value))
        step = float(rng.uniform(-reach, reach))
        moved.append(neat(round(value + step) if entry.whole else value + step))
    return tuple(moved)


def within(entry: Input, values: Values) -> Values:
    """Return the values moved into the valid range, or to the nearest choice; what has neither stays."""
    if entry.choices:
        return tuple(min(entry.choices, key=lambda choice: abs(choice - value)) for value in values)
    if not math.isfinite(entry.high - entry.low):
        return values
    kept = (min(max(value, entry.low), entry.high) for value in values)
    return tuple(float(round(value)) if entry.whole else value for value in kept)


def _whole_or_real(rng: Rng, low: float, high: float, whole: bool) -> float:
    if whole and math.ceil(low) <= math.floor(high):
        return float(rng.integers(math.ceil(low), math.floor(high) + 1))
    value = float(rng.uniform(low, high))
    return float(round(value)) if whole else neat(value)


def _stick(rng: Rng, entry: Input, beyond: float) -> float:
    """A third at one of the ends, where sticks do most; some beyond, as a failing radio sends; the rest evenly."""
    pick = rng.random()
    if pick < 0.5 * beyond:
        low_end = rng.random() < 0.5
        reach = STICK_BEYOND * (entry.high - entry.low)
        low, high = (entry.low - reach, entry.low) if low_end else (entry.high, entry.high + reach)
        return _whole_or_real(rng, low, high, entry.whole)
    if pick < 0.5 * beyond + 1 / 3:
        return entry.low if rng.random() < 0.5 else entry.high
    return _whole_or_real(rng, entry.low, entry.high, entry.whole)


def _within(rng: Rng, entry: Input) -> float:
    low, high = entry.low, entry.high
    if math.isnan(low) and math.isnan(high):
        return _any_size(rng)
    if math.isnan(high):
        high = max(UNBOUNDED_HIGH, low + 1.0)
    if math.isnan(low):
        low = min(-UNBOUNDED_HIGH, high - 1.0)
    edge = rng.random()
    if edge < 0.1:
        return low
    if edge < 0.2:
        return high
    return _whole_or_real(rng, low, high, entry.whole)


def _any_size(rng: Rng) -> float:
    """A number of any size from a thousandth to ten thousand, either sign, sometimes 0."""
    if rng.random() < 0.1:
        return 0.0
    size = 10.0 ** rng.uniform(-3.0, 4.0)
    return neat(float(size if rng.random() < 0.5 else -size))


def _beyond(rng: Rng, entry: Input) -> float:
    low, high = entry.low, entry.high
    low = high if math.isnan(low) else low
    high = low if math.isnan(high) else high
    if math.isnan(low):
        return _any_size(rng)
    span = max(high - low, abs(high), 1.0)
    pick = int(rng.integers(5))
    if pick == 0:
        return neat(low - span * float(rng.uniform(0.0, 1.0)))
    if pick == 1:
        return neat(high + span * float(rng.uniform(0.0, 1.0)))
    if pick == 2:
        return neat(high * 10.0 ** float(rng.uniform(1.0, 4.0)) if high > 0 else low - 1.0)
    return (-1.0, 0.0)[pick - 3]


def _command(rng: Rng, name: str, beyond: float) -> Values:
    """Seven numbers as PGFuzz draws them; where it is known what they mean, mostly such."""
    numbers = [_number(rng, beyond) for _ in range(commands.COUNT)]
    if not commands.known(name):
        return tuple(numbers)
    telling = commands.telling(name)
    for place, number in enumerate(commands.draw(rng, name)):
        if number is not None and (place not in telling or rng.random() >= beyond):
            numbers[place] = number
        elif number is not None and rng.random() < 0.5:
            numbers[place] = -number
    return tuple(numbers)


def _number(rng: Rng, beyond: float) -> float:
    pick = rng.random()
    if pick < 0.2:
        return 0.0
    if pick < 0.2 + 0.5 * beyond:
        return -float(rng.integers(1, 101))
    if pick < 0.2 + beyond:
        return neat(float(rng.uniform(0.0, 1.0)))
    return float(rng.integers(1, 101))
