"""What an operator may change while a campaign flies, as it was in force at the end, and at first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from saflite.console.run_data.run_folder import RunFolder
from saflite.contract.config import Campaign
from saflite.contract.events import BudgetChanged, ScorerChanged


class InForce(NamedTuple):
    """Budgets, and models that decided: first those the campaign began with, then those ordered, in order."""

    budgets: tuple[int, ...]
    scorers: tuple[str, ...]

    @property
    def budget(self) -> int:
        """First flights that may be flown."""
        return self.budgets[-1]

    @property
    def scorer(self) -> str:
        """The model that decides."""
        return self.scorers[-1]


def at_first(campaign: Campaign) -> InForce:
    """Return what a campaign begins with."""
    return InForce((campaign.budget_flights,), (campaign.scorer.model,))


def in_force(run: RunFolder) -> InForce:
    """Return what was in force in a run: its campaign, and the changes that its events tell of."""
    first = at_first(run.campaign)
    scorers = (fact.model for fact in run.facts(ScorerChanged) if fact.ready and fact.decides)
    return InForce((*first.budgets, *budgets(run)), (*first.scorers, *scorers))


def budgets(run: RunFolder) -> tuple[int, ...]:
    """Return the budgets ordered, in order."""
    return tuple(fact.budget for fact in run.facts(BudgetChanged))


def in_words(values: Sequence[object]) -> str:
    """Return what came last, and, where that was changed, what was first."""
    changes = len(values) - 1
    if not changes:
        return str(values[-1])
    often = f", {changes} changes" if changes > 1 else ""
    return f"{values[-1]} ({values[0]} at first{often})"
