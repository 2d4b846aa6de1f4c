"""Values outside their documented range: which settings take them although they should not, and what to set those to.

A target that checks ranges refuses such a value and flies on as if nothing had been given: asking costs nothing. One
that takes it where it refuses most others does not check there, and whatever reads the setting was never meant to see
it. Where a target takes most of what is asked (many real autopilots do) asking tells nothing and would disturb: then
hardly anything is asked, and nothing singled out.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection

import numpy as np

from saflite.contract.test_case import StimulusKind, TestCase
from saflite.mutator.operators import values
from saflite.mutator.operators.inputs import Have, Input

Rng = np.random.Generator
Key = tuple[StimulusKind, str]
AT_ONCE_MAX, AT_ONCE = 8, 4.0  # asked in one test case; given of those known to take any value
TRUST = 8.0  # settings asked after which what was seen weighs as much as the guess that most are refused
GUESSED_TAKEN = 0.1
STEEPNESS = 6.0
STANDS_OUT = 0.5  # worth of an answer from which on
SAME_SHARE, NEAR_SHARE = 0.3, 0.4


class Probes:
    """What was asked beyond its range, and what took it."""

    def __init__(self, have: Have) -> None:
        self._bounded = tuple(entry for entry in have.values() if _asks(entry))
        self._asked: Counter[Key] = Counter()
        self._taken: Counter[Key] = Counter()
        self._ended: Counter[Key] = Counter()
        self._inputs = {(entry.kind, entry.name): entry for entry in self._bounded}

    def tell(self, case: TestCase, given: Collection[int], taken: Collection[int], *, ended: bool = False) -> None:
        """Learn from the inputs of a flight, by their places: those that were given, those that were taken.

        `ended`: it broke a rule or crashed, so what was set is known for that, and hides all else.
        """
        for place in sorted(given):
            stimulus = case.stimuli[place]
            entry = self._inputs.get((stimulus.kind, stimulus.name))
            if entry is not None and stimulus.values and not entry.low <= stimulus.values[0] <= entry.high:
                self._asked[entry.kind, entry.name] += 1
                self._taken[entry.kind, entry.name] += place in taken
                self._ended[entry.kind, entry.name] += ended and place in taken

    @property
    def lax(self) -> tuple[Input, ...]:
        """The settings that took a value outside their range, in a fixed order."""
        return tuple(self._inputs[key] for key in sorted(self._taken) if self._taken[key])

    @property
    def singled_out(self) -> frozenset[str]:
        """The names of the lax settings, where the target refuses so much that they stand out."""
        return frozenset(entry.name for entry in self.lax if self._worth > STANDS_OUT)

    @property
    def at_once(self) -> int:
        """How many to ask in one test case: few where most are taken."""
        return min(len(self._bounded), round(AT_ONCE_MAX * self._worth))

    @property
    def _worth(self) -> float:
        """What an answer says, 0 to 1: little where most values are taken."""
        share = (len(self.lax) + TRUST * GUESSED_TAKEN) / (len(self._asked) + TRUST)
        return math.pow(1.0 - share, STEEPNESS)

    def draw(self, rng: Rng) -> Input:
        """Return a setting to ask, those least asked before others."""
        weights = [1.0 / (1.0 + self._asked[entry.kind, entry.name]) ** 2 for entry in self._bounded]
        edges = np.cumsum(weights)
        place = int(np.searchsorted(edges, rng.random() * edges[-1], side="right"))
        return self._bounded[min(place, len(self._bounded) - 1)]

    def lax_values(self, rng: Rng, chance: float) -> list[tuple[Input, float]]:
        """Return some of the lax settings with values; two of them may get one value, which differences do not bear."""
        each = chance * self._worth / max(1.0, len(self.lax) / AT_ONCE)
        ended = (self._ended[entry.kind, entry.name] for entry in self.lax)
        chosen = [entry for entry, times in zip(self.lax, ended, strict=True) if rng.random() < each / (1.0 + times)]
        found = [(entry, beyond(rng, entry)) for entry in chosen]
        if len(found) > 1 and rng.random() < SAME_SHARE:
            found = [(entry, found[0][1]) for entry, _ in found]
        return found


def beyond(rng: Rng, entry: Input) -> float:
    """Return a value outside the range: a little outside it, of either sign, 0, or of any size."""
    span = max(entry.high - entry.low, 1e-3)
    if rng.random() < NEAR_SHARE:
        by = span * math.exp(rng.uniform(math.log(0.02), math.log(2.0)))
        value = entry.high + by if rng.random() < 0.5 else entry.low - by
        return values.neat(math.copysign(math.ceil(abs(value)), value) if entry.whole else value)
    return values.draw(rng, entry, 1.0)[0]


def _asks(entry: Input) -> bool:
    bounded = math.isfinite(entry.high - entry.low) and not entry.choices
    return bounded and entry.kind == "parameter" and not entry.at_start
