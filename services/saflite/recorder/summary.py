"""What is exported from a campaign: the campaign and its violations with all that is known of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

    `circumstances` is what maintainers ask first; None where it was not worked out. `smallest_form_of` names the test
    case that it was made of by minimising, empty for a find of the search.
    """

    violation: Violation
    test_case: TestCase
    judgement: Judgement | None = None
    recording: str = ""
    circumstances: Circumstances | None = None
    smallest_form_of: str = ""


class Find(NamedTuple):
    """A finding that counts, with its smallest forms among the findings, which are no finds of their own."""

    finding: Finding
    smallest_forms: tuple[Finding, ...] = ()


class RunSummary(NamedTuple):
    """A campaign's result. `flights` counts confirmations too; `held` counts test cases flown without violation.

    `withheld` counts findings of memory safety that are not among `findings`: they are reported in private first.
    `pending` counts by policy the test cases that violated it and have not been decided upon; `unproven` all violations
    that are neither confirmed nor refuted, the unconfirmed findings among them. `state` says in words how the run
    stands and why, `failed` what broke before the `budget` of first flights was flown and judged, empty if nothing did;
    a run that was killed broke. `unfinished`: it still works, or was interrupted.
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
    budget: int = 0
    state: str = ""
    failed: str = ""
    unfinished: bool = False

    @property
    def shortfall(self) -> str:
        """Say what of the budget was flown and why no more; empty where it was flown to the end."""
        if self.flights >= self.budget and not self.failed and not self.unfinished:
            return ""
        told = f"{self.flights} of {self.budget} flights; {self.state}"
        return told if self.failed in self.state else f"{told}; {self.failed}"

    def finds(self) -> tuple[Find, ...]:
        """Return what counts of the findings."""
        return finds_of(self.findings)


def finds_of(findings: Sequence[Finding]) -> tuple[Find, ...]:
    """Return what counts of findings, in their order; a smallest form does only where its find is not among them."""
    forms: dict[tuple[str, str], list[Finding]] = {}
    for one in findings:
        if not one.smallest_form_of:
            forms[one.violation.test_case, one.violation.policy] = []
    counted = []
    for one in findings:
        found = forms.get((one.smallest_form_of, one.violation.policy))
        counted.append(one) if found is None else found.append(one)
    return tuple(Find(one, tuple(forms.get((one.violation.test_case, one.violation.policy), ()))) for one in counted)
