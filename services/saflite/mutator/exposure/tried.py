"""Which ways of putting a rule to the test were flown: of those that a procedure leaves open the least flown is next.

By chance alone more than a third of what is drawn as often as there are ways to draw it never comes. Source: covering
designs, each choice by itself (Cohen, Dalal, Fredman and Patton 1997), without their pairs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from itertools import zip_longest

import numpy as np

from saflite.contract.test_case import TestCase
from saflite.mutator.exposure.attention import Span, read_spans
from saflite.mutator.exposure.procedures import Procedure

Rng = np.random.Generator
PARTS, OPTION = "-", "."


class Tried:
    """How often each option of each choice was flown, and how often it stands in the test cases just proposed."""

    def __init__(self) -> None:
        self._flown: Counter[tuple[str, int]] = Counter()
        self._planned: Counter[tuple[str, int]] = Counter()

    def begin(self) -> None:
        """Forget what was only proposed: the next ones are proposed."""
        self._planned.clear()

    def least(self, rng: Rng, choice: str, options: Sequence[int]) -> int:
        """Return the option that was taken least, by lot among those alike."""
        often = [self._flown[choice, option] + self._planned[choice, option] for option in options]
        among = [option for option, times in zip(options, often, strict=True) if times == min(often)]
        taken = among[int(rng.integers(len(among)))]
        self._planned[choice, taken] += 1
        return taken

    def tell(self, case: TestCase, given: Collection[int], items: Iterable[tuple[str, int]] = ()) -> None:
        """Learn from a flight, whose origin tells which phase was what, and from the places of the inputs given in it.

        A phase counts where its last input was given: the flight was not over before. `items` of its mission count.
        """
        self._flown.update(items)
        spans = read_spans(case.origin.note)
        for span, following in zip_longest(spans, spans[1:]):
            to_s = following.from_s if following is not None else math.inf
            within = [place for place, one in enumerate(case.stimuli) if span.from_s <= one.at_s < to_s]
            if span.variant and within and within[-1] in given:
                self._flown.update(_choices(span))


class Variant:
    """One way through a procedure, chosen step by step; `text` tells it in the note of a test case."""

    def __init__(self, tried: Tried, rng: Rng, procedure: Procedure) -> None:
        """Take where it stands what was flown."""
        self._tried, self._rng, self._procedure = tried, rng, procedure
        self._taken: list[str] = []

    def __call__(self, place: int, count: int) -> int:
        """Return which of `count` options is taken at a place where the procedure leaves one open."""
        option = self._tried.least(
            self._rng, _choice(self._procedure.policy, self._procedure.number, place), range(count)
        )
        self._taken.append(f"{place}{OPTION}{option}")
        return option

    @property
    def text(self) -> str:
        """The procedure and the options taken."""
        return PARTS.join([str(self._procedure.number), *self._taken])


def _choice(policy: str, number: int, place: int) -> str:
    return f"{policy} {number} {place}"


def _choices(span: Span) -> list[tuple[str, int]]:
    number, *taken = span.variant.split(PARTS)
    parts = [one.partition(OPTION) for one in taken]
    options = [(_choice(span.policy, int(number), int(place)), int(option)) for place, _, option in parts]
    return [(span.policy, int(number)), *options]
