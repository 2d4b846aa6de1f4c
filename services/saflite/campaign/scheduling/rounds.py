"""Rounds: how many flights each may have, so that the budget is spent to the end and never exceeded. Pure.

The budget counts first flights, one for each test case; re-flights, checks and shrinking are counted beside it. A round
may fly fewer than it was planned with (too few candidates). Round r is planned on the exact costs of the rounds up to
r - lag and on the plans of those in between, whatever has ended by then: so the plan does not depend on timing. Where
these leave nothing over, a round stays empty until exact costs are known. Neither does it depend on timing when the
strategy is asked no more for want of anything new: that, too, is read from the rounds up to r - lag.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import islice
from typing import Literal, NamedTuple

from saflite.contract.config import SearchConfig
from saflite.contract.score import Score
from saflite.contract.test_case import TestCase
from saflite.contract.work import Outcome

Phase = Literal["mutating", "scoring", "scored", "flying", "closed"]


DRY_ROUNDS = 6
"""After so many rounds in a row without anything new to fly, known of when the next one is planned, none is."""


class Plan(NamedTuple):
    """What a round may spend: `flights` first flights."""

    flights: int

    @property
    def reserved(self) -> int:
        """The most the round can cost."""
        return self.flights


@dataclass(slots=True)
class Round:
    """One round from its plan to its last outcome."""

    number: int
    plan: Plan
    phase: Phase = "mutating"
    cost: int = 0
    candidates: dict[str, TestCase] = field(default_factory=dict)
    scores: dict[str, Score] = field(default_factory=dict)
    batches: list[tuple[str, ...]] = field(default_factory=list)
    open_trials: int = 0
    outcomes: dict[int, Outcome] = field(default_factory=dict)

    def told(self) -> tuple[Outcome, ...]:
        """Return the outcomes in order of rank."""
        return tuple(self.outcomes[rank] for rank in sorted(self.outcomes))

    def kinds(self) -> dict[str, str]:
        """Return what each candidate is expected to show, by its identity."""
        return {name: score.kind for name, score in self.scores.items()}

    def forget_candidates(self) -> None:
        """Drop what is not needed once the flights are chosen."""
        self.candidates, self.scores, self.batches = {}, {}, []


class Rounds:
    """All rounds: those under way, and of the closed ones what planning and telling need."""

    def __init__(self, search: SearchConfig, budget: int) -> None:
        self.search = search
        self.budget = budget
        self.under_way: dict[int, Round] = {}
        self.recent: deque[Round] = deque(maxlen=2 * search.lag + 4)
        self.planned = 0  # rounds planned so far; the next one has this number
        self.closed_upto = -1  # every round up to this one is closed
        self.selected_upto = -1  # every round up to this one has its flights chosen
        self.dry = 0  # rounds in a row, up to `_known_upto`, that found nothing new to fly
        self._known_cost = 0  # exact cost of the rounds up to `_known_upto`
        self._known_upto = -1
        self._costs: dict[int, tuple[int, int]] = {}  # number: (reserved, exact), of rounds not in `_known_cost` yet

    def may_plan(self) -> bool:
        """Whether the outcomes the next round draws on are known."""
        last = self.under_way.get(self.planned - 1)
        return self.closed_upto >= self.planned - self.search.lag and (last is None or last.phase != "mutating")

    def next_plan(self) -> Plan | None:
        """Return the plan of the next round; None if the budget leaves none, whatever the rounds under way cost.

        None, too, if the strategy had nothing new for too long.
        """
        known = self._known(self.planned - self.search.lag)
        if self.dry >= DRY_ROUNDS:
            return None
        reserved = sum(reserve for number, (reserve, _) in self._costs.items() if number > self._known_upto)
        flights = min(self.search.flights_per_round, self.budget - known - reserved)
        if flights > 0:
            return Plan(flights)
        return Plan(0) if reserved else None

    def open(self, plan: Plan) -> Round:
        """Begin the next round."""
        number, self.planned = self.planned, self.planned + 1
        self._costs[number] = (plan.reserved, 0)
        self.under_way[number] = Round(number, plan)
        return self.under_way[number]

    def close(self, number: int) -> None:
        """Note that every test case of the round has ended."""
        closing = self.under_way[number]
        closing.phase = "closed"
        self._costs[number] = (closing.plan.reserved, closing.cost)
        while (first := self.under_way.get(self.closed_upto + 1)) is not None and first.phase == "closed":
            self.closed_upto += 1
            self.recent.append(self.under_way.pop(self.closed_upto))

    def next_to_select(self) -> Round | None:
        """Return the round whose flights are to be chosen now: rounds are chosen in order."""
        while (
            waiting := self.under_way.get(self.selected_upto + 1)
        ) is not None or self.selected_upto < self.closed_upto:
            if waiting is None or waiting.phase in ("closed", "flying"):
                self.selected_upto += 1
                continue
            return waiting if waiting.phase == "scored" else None
        return None

    def outstanding(self) -> int:
        """Return the most that rounds under way can still add to the flights flown."""
        return sum(round_.plan.reserved - round_.cost for round_ in self.under_way.values() if round_.phase != "closed")

    def told_between(self, after: int, upto: int) -> tuple[Outcome, ...] | None:
        """Return the outcomes of the rounds in (after, upto], None if they are no longer held here."""
        if upto <= after:
            return ()
        first = self.closed_upto + 1 - len(self.recent)
        if after + 1 < first or upto > self.closed_upto:
            return None
        asked = islice(self.recent, after + 1 - first, upto + 1 - first)
        return tuple(outcome for round_ in asked for outcome in round_.told())

    def _known(self, upto: int) -> int:
        """Return the exact cost of the rounds up to `upto`, all of which are closed."""
        while self._known_upto < upto:
            self._known_upto += 1
            reserved, cost = self._costs.pop(self._known_upto)
            self._known_cost += cost
            if reserved:
                self.dry = 0 if cost else self.dry + 1
        return self._known_cost
