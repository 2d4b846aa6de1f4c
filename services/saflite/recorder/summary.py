"""What is exported from a campaign: the campaign and its violations with all that is known of each."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from saflite.contract.circumstances import Circumstances
from saflite.contract.config import Campaign
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import NEVER_APPLIED, Judgement, Violation


class Rulings(NamedTuple):
    """What a policy said of a run's test cases, each counted once, by its first flight."""

    held: int = 0
    violated: int = 0
    vacuous: int = 0
    inconclusive: int = 0

    @property
    def judged(self) -> int:
        """Test cases that were judged by it."""
        return sum(self)

    @property
    def applied(self) -> int:
        """Test cases in which the rule applied at some moment."""
        return self.held + self.violated

    def text(self) -> str:
        """Return the counts in words."""
        if self.judged and self.vacuous == self.judged:
            return f"vacuous: {NEVER_APPLIED} in {self.judged} flights"
        left = f", inconclusive in {self.inconclusive}" if self.inconclusive else ""
        return f"applied in {self.applied} of {self.judged} flights, violated in {self.violated}{left}"


class PolicyFacts(NamedTuple):
    """What a reader of an export wants to know of a policy."""

    id: str
    title: str
    interestingness: str
    source: str
    rulings: Rulings = Rulings()


class Finding(NamedTuple):
    """One violation: its test case, the judgement on its first flight, and its recording relative to the run folder.

    `circumstances` is what maintainers ask first; None where it was not worked out.
    """

    violation: Violation
    test_case: TestCase
    judgement: Judgement | None = None
    recording: str = ""
    circumstances: Circumstances | None = None


class RunSummary(NamedTuple):
    """A campaign's result. `flights` counts confirmations too; `held` counts test cases flown without violation.

    `withheld` counts findings of memory safety that are not among `findings`: they are reported in private first.
    `pending` counts by policy the test cases that violated it and have not been decided upon; `unproven` all violations
    that are neither confirmed nor refuted, the unconfirmed findings among them.
    """

    campaign: Campaign
    policies: tuple[PolicyFacts, ...]
    findings: tuple[Finding, ...]
    flights: int
    held: int
    elapsed_s: float = 0.0
    version: str = ""
    withheld: int = 0
    pending: Mapping[str, int] = MappingProxyType({})
    unproven: int = 0
