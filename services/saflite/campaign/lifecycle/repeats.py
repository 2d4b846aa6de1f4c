"""How many flights tell whether a test case violates again: k of n, for noise plays a part on every target. Pure."""

from __future__ import annotations

from typing import NamedTuple

from saflite.contract.config import SearchConfig
from saflite.contract.target_info import Repeats

DEFAULT_FLIGHTS: dict[Repeats, int] = {"bitwise": 3, "statistically": 5}
"""Re-flights of a violation where the campaign does not say how many."""


class RepeatRule(NamedTuple):
    """A test case violates again if `needed` of `flights` flights do."""

    repeats: Repeats
    flights: int
    needed: int

    def decide(self, failed: int, flown: int) -> bool | None:
        """Return whether it violates again after `failed` of `flown` flights did; None while that is open."""
        if failed >= self.needed:
            return True
        return False if failed + self.flights - flown < self.needed else None

    def least_to_decide(self, failed: int, flown: int) -> int:
        """Return how many more flights it takes at least until `decide` gives an answer."""
        return min(self.needed - failed, self.flights - self.needed + 1 - (flown - failed))


ONE_FLIGHT = RepeatRule("bitwise", 1, 1)
"""The rule where one and the same noise is flown over and over, and flights repeat bit by bit."""


def confirm_rule(search: SearchConfig, repeats: Repeats) -> RepeatRule:
    """Return the rule by which violations are confirmed.

    What the campaign leaves open: three flights on a target that repeats bit by bit, where only the noise we know of
    differs; on others five; and more than half of them.
    """
    flights = search.confirm_flights
    if flights is None:
        flights = max(DEFAULT_FLIGHTS[repeats], search.confirm_needed or 0)
    needed = search.confirm_needed
    if needed is None:
        needed = flights // 2 + 1
    return RepeatRule(repeats, flights, needed)


def shrink_rule(confirm: RepeatRule) -> RepeatRule:
    """Return the rule by which a smaller test case still violates: under its own noise one bit-equal flight tells it.

    Whether the smallest form does so under other noise is confirmed in the end, as for any violation.
    """
    return ONE_FLIGHT if confirm.repeats == "bitwise" else confirm


def shrink_flights_max(search: SearchConfig, rule: RepeatRule, *, is_first: bool) -> int:
    """Return how many flights may be spent on making one violation smaller: half for further behaviours of a policy."""
    most = 60 * rule.flights if search.shrink_flights_max is None else search.shrink_flights_max
    return most if is_first else most // 2
