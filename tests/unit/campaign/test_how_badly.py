"""A find is told with what its re-flights showed, not only with the flight it was chosen for."""

from __future__ import annotations

import pytest

from saflite.campaign.lifecycle.confirmation import Broken, FlightNote, Trial, violations_of
from saflite.campaign.lifecycle.repeats import RepeatRule
from saflite.contract.flight import Flight
from saflite.contract.test_case import Scenario, StartState, Target, TestCase, identity
from saflite.contract.verdict import Judgement, Verdict, failed_again

CASE = TestCase(target=Target(), scenario=Scenario(start=StartState()))


def flown(severity: str, *again: Broken | None) -> str:
    """Return in words what a find of this severity, -1.5, came to in its re-flights."""
    worst = Verdict(policy="p", outcome="violated", robustness=-1.5, severity=severity)  # type: ignore[arg-type]
    notes = {
        index: FlightNote(
            Flight(test_case=identity(CASE), flight_index=index, ending="completed"),
            judged=True,
            violated={} if one is None else {"p": one},
        )
        for index, one in enumerate((Broken(-1.5, severity == "hard"), *again))
    }
    judgement = Judgement(test_case=identity(CASE), flight_index=0, verdicts=(worst,))
    trial = Trial(CASE, identity(CASE), 0, 0, confirm_max=len(again), flights=notes, judgement=judgement)
    trial.behaviours = {"p": "0123456789abcdef"}
    (violation,) = violations_of(trial, RepeatRule("bitwise", 3, 2))
    assert violation.robustness == -1.5
    return failed_again(violation).partition("rate ")[2].partition(", ")[2]


@pytest.mark.parametrize(
    ("severity", "again", "told"),
    [
        ("hard", [Broken(-1.1, False), None, Broken(-1.5, True)], "robustness then -1.500 to -1.100, hard in 1"),
        ("hard", [Broken(-0.4, False), Broken(-0.1, False)], "robustness then -0.400 to -0.100, hard in none"),
        ("soft", [Broken(-0.4, False), Broken(-0.1, False)], "robustness then -0.400 to -0.100"),
        ("soft", [Broken(-1.5, True), Broken(-1.5, True)], "robustness then -1.500, hard in 2"),
        ("soft", [None, None, None], ""),
    ],
)
def test_what_the_re_flights_showed_is_told(severity: str, again: list[Broken | None], told: str) -> None:
    assert flown(severity, *again) == told
