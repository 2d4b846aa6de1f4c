"""Which arm is worth the next test case: Thompson sampling over rates of credit per cost, what is old fading.

The rate of an arm has a gamma posterior: its credit so far over its cost so far, and one credit at the mean rate of all
arms as prior. A test case goes to the arm whose drawn rate is the greatest, so an arm gets as large a share as it is
likely to be the best. Source: Thompson 1933; discounted as in Raj & Kalyani 2017 (arXiv:1707.09727).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(slots=True)
class Earned:
    """What one arm earned and what it cost, discounted; the cost in any unit that all arms share."""

    credit: float = 0.0
    cost: float = 0.0


class Bandit:
    """What was told of each arm. `memory` is the number of results after which one counts half."""

    def __init__(self, arms: Sequence[str], memory: float) -> None:
        self._earned = {arm: Earned() for arm in arms}
        self._kept = 0.5 ** (1.0 / memory)

    def tell(self, arm: str, credit: float, cost: float) -> None:
        """Add one result of an arm; results of others fade with it."""
        for earned in self._earned.values():
            earned.credit *= self._kept
            earned.cost *= self._kept
        self._earned[arm].credit += credit
        self._earned[arm].cost += cost

    def shares(self, rng: np.random.Generator, count: int) -> dict[str, int]:
        """Return how many of `count` test cases each arm is to propose, one draw for each."""
        held = self._earned.values()
        credit, cost = sum(one.credit for one in held), sum(one.cost for one in held)
        prior_cost = cost / max(1.0, credit) or 1.0  # before any find: one in all there was
        shapes = np.array([1.0 + one.credit for one in held])
        costs = np.array([prior_cost + one.cost for one in held])
        best = np.argmax(rng.gamma(shapes, 1.0 / costs, (count, len(shapes))), axis=1)
        return dict(zip(self._earned, np.bincount(best, minlength=len(shapes)).tolist(), strict=True))
