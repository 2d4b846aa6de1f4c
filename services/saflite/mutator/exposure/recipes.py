"""How rules were brought to apply: the inputs shortly before they did, to be given again with something changed.

Most rules need several things at once, and a search that draws each by itself brings them together again only as often
as by chance. What led to it once is kept, leads to it again mostly, and each time something about it is other.
What does not lead there again is pushed out by what does: a few of the latest are kept of each policy.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from saflite.contract.test_case import Stimulus, TestCase

Rng = np.random.Generator
KEPT = 6  # of each policy
INPUTS_MAX, INPUTS_LEAST = 8, 3  # at most; where none was given for long: a landing takes its time
BEFORE_S = 15.0  # inputs that long before a rule applied, and before the time that it waits for, may have led to it
SELDOM_LEAST = 0.15  # share of the chance that a mode keeps in which a rule has applied often
COMMON = 0.4  # a rule that applies in this share of flights needs no recipe


class Recipe(NamedTuple):
    """What was given in the `lasted_s` before a rule applied, times from the first on, and the mode it began in."""

    stimuli: tuple[Stimulus, ...]
    lasted_s: float
    mode: str


class Recipes:
    """The latest recipes of every policy, and how many flights its rule applied in."""

    def __init__(self, quiet_s: Mapping[str, float]) -> None:
        self._quiet_s = quiet_s
        self._kept: dict[str, deque[Recipe]] = {}
        self._flights = 0
        self._applied: dict[str, int] = {}
        self._modes: Counter[tuple[str, str]] = Counter()

    def tell(self, case: TestCase, applied_s: Mapping[str, float], taken: Sequence[int]) -> None:
        """Learn from a flight: when which rules first applied, and the places of the inputs that were taken."""
        self._flights += 1
        for policy, at_s in applied_s.items():
            self._applied[policy] = self._applied.get(policy, 0) + 1
            self._modes[policy, _mode(case, at_s, taken)] += 1
            recipe = _recipe(case, at_s, self._quiet_s.get(policy, 0.0) + BEFORE_S, taken)
            if recipe is not None:
                self._kept.setdefault(policy, deque(maxlen=KEPT)).append(recipe)

    def seldom(self, policy: str, mode: str) -> float:
        """Return 1 for a mode in which a rule never applied; less, down to a share, the more flights it did in."""
        return max(SELDOM_LEAST, 1.0 / (1.0 + self._modes[policy, mode]))

    def draw(self, rng: Rng, policy: str) -> Recipe | None:
        """Return a recipe of a policy; None if none is known, or its rule applies in many flights anyway."""
        kept = self._kept.get(policy)
        if not kept or self._applied[policy] > COMMON * self._flights:
            return None
        return kept[int(rng.integers(len(kept)))]


def _recipe(case: TestCase, at_s: float, within_s: float, taken: Sequence[int]) -> Recipe | None:
    before = [case.stimuli[place] for place in sorted(taken) if case.stimuli[place].at_s <= at_s]
    late = [one for one in before if one.at_s >= at_s - within_s] or before[-INPUTS_LEAST:]
    late = late[-INPUTS_MAX:]
    if not late:
        return None
    first_s = late[0].at_s
    return Recipe(tuple(late), at_s - first_s, _mode(case, first_s, taken))


def _mode(case: TestCase, at_s: float, taken: Sequence[int]) -> str:
    """Return the mode given last before a moment; that of the start where none was, empty for a mission."""
    before = [one.name for one in (case.stimuli[place] for place in taken) if one.kind == "mode" and one.at_s < at_s]
    start = case.scenario.start
    return before[-1] if before else start.mode if start is not None else ""
