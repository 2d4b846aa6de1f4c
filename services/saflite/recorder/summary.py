"""What is exported from a campaign: the campaign and its violations with all that is known of each."""

from __future__ import annotations

from typing import NamedTuple

from saflite.contract.config import Campaign
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement, Violation


class PolicyFacts(NamedTuple):
    """What a reader of an export wants to know of a policy."""

    id: str
    title: str
    interestingness: str
    source: str


class Finding(NamedTuple):
    """One violation: its test case, the judgement on its first flight, and its recording relative to the run folder."""

    violation: Violation
    test_case: TestCase
    judgement: Judgement | None = None
    recording: str = ""


class RunSummary(NamedTuple):
    """A campaign's result. `flights` counts confirmations too; `held` counts test cases flown without violation."""

    campaign: Campaign
    policies: tuple[PolicyFacts, ...]
    findings: tuple[Finding, ...]
    flights: int
    held: int
    elapsed_s: float = 0.0
    version: str = ""
