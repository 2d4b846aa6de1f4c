"""What the test cases flown so far put to the test: rules that applied, states of the target, steps between them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement

Step = tuple[str, str, str, str]
"""State before, state after, kind of the input given, kind of the one before it; empty where there is none."""


ARMS_MAX = 256
"""Arms of a portfolio that are told apart: a mutator can name a new one with each test case."""


@dataclass(slots=True)
class ArmCounts:
    """What an arm of a portfolio had flown, and the behaviours its test cases were the first to show."""

    flights: int = 0
    founded: int = 0

    def add(self, founded: int) -> None:
        """Count one test case."""
        self.flights += 1
        self.founded += founded


@dataclass(slots=True)
class Exposure:
    """Counts over first flights that were judged."""

    judged: int = 0
    applied: Counter[str] = field(default_factory=Counter)
    states: Counter[str] = field(default_factory=Counter)
    steps: set[Step] = field(default_factory=set)

    def add(self, case: TestCase, judgement: Judgement) -> None:
        """Count one flight."""
        self.judged += 1
        self.applied.update({one.policy for one in judgement.verdicts if one.outcome in ("held", "violated")})
        self.states.update({state for one in judgement.transitions for state in (one.before, one.after)})
        self.steps |= {
            (one.before, one.after, _kind(case, one.stimulus), _kind(case, one.preceding))
            for one in judgement.transitions
        }

    def applied_share(self, policies: tuple[str, ...]) -> float:
        """Return the share of verdicts in which the rule applied, all policies counted alike, 0 to 1.

        One that a run of an earlier version names twice counts once, also in what such a run has counted so far.
        """
        each = set(policies)
        return sum(min(self.applied[name], self.judged) for name in each) / max(1, self.judged * len(each))


def _kind(case: TestCase, place: int) -> str:
    return case.stimuli[place].kind if 0 <= place < len(case.stimuli) else ""
