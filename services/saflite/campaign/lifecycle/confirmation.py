"""Violated, or flaky: what the re-flights of a test case say about its violations. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec

from saflite.campaign.lifecycle.repeats import RepeatRule
from saflite.campaign.scheduling.work_keys import FlyKey
from saflite.contract.flight import Flight, Purpose
from saflite.contract.interval import wilson
from saflite.contract.score import Score
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Confirmation, Judgement, Verdict, Violation, worst

LATER_S = 30.0
"""So much later than the first flight a re-flight may show the same violation; no policy looks further ahead, either.

What it shows later still is another one: a vehicle that found no way on wanders to the time limit. Only where flights
repeat bit by bit; where they differ by nature, moments do, too.
"""


class Broken(NamedTuple):
    """How badly a flight broke a policy."""

    robustness: float
    is_hard: bool


@dataclass(slots=True)
class FlightNote:
    """What the books remember of one flight until its test case has ended."""

    flight: Flight
    judged: bool = False
    given_up: bool = False  # it could not be flown or judged
    violated: dict[str, Broken] = field(default_factory=dict)  # by policy

    @property
    def settled(self) -> bool:
        """Whether nothing more is to be learned from it."""
        return self.judged or self.given_up


@dataclass(slots=True)
class Trial:
    """A selected test case from its first flight to its end."""

    test_case: TestCase
    name: str
    round: int
    rank: int
    confirm_max: int
    score: Score | None = None
    wanted_build: str = ""  # the build its first flight is to be on, empty for any
    first: int = 0  # the flight that shows the violation, re-flights come after it
    shrunk_from: Violation | None = None  # the violation this one is the smallest form of
    larger_forms: tuple[TestCase, ...] = ()  # smaller than the original, larger than this one; the smallest last
    flights: dict[int, FlightNote] = field(default_factory=dict)
    traces_lost: Counter[int] = field(default_factory=Counter)  # by flight: before it was judged
    judgement: Judgement | None = None
    behaviours: dict[str, str] = field(default_factory=dict)  # fingerprints, by the policy violated
    asked: int = 0  # re-flights asked for so far, `confirm_max` at most
    founded: int = 0  # how many of them it was the first to show
    checked: bool = False  # its first flight was asked for once more, to see whether it repeats bit by bit
    waiting: bool = False  # for test cases selected before it
    stood: frozenset[str] = frozenset()  # policies it was confirmed to violate

    def purpose_of(self, index: int) -> Purpose:
        """Return what flight `index` is flown for."""
        return "shrunk" if self.shrunk_from is not None else "confirm" if index else "search"

    def fly_key(self, index: int) -> FlyKey:
        """Return the key of a flight."""
        return FlyKey(self.name, self.purpose_of(index), index)

    @property
    def build(self) -> str:
        """The build its re-flights are to be on: that of the flight that shows the violation, once it is flown."""
        note = self.flights.get(self.first)
        return self.wanted_build if note is None else note.flight.build

    def until_s(self, index: int) -> float | None:
        """Return the simulated time at which all that flight `index` is flown for has been seen; None: at its end."""
        if self.judgement is None or index not in self.reflights:
            return None
        bad, whole_s = violated_verdicts(self.judgement), self.flights[self.first].flight.simulated_s
        is_hard = any(verdict.severity == "hard" for verdict in bad)  # perhaps for how the flight ended
        last_s = max(whole_s if is_hard else 0.0, *(verdict.witness_to_s for verdict in bad))
        until_s = round(last_s + LATER_S, 1)
        return until_s if until_s < self.test_case.scenario.time_limit_s else None

    @property
    def is_selected(self) -> bool:
        """Whether a round selected it; otherwise it is the smallest form of a violation, beside the budget."""
        return self.shrunk_from is None

    @property
    def reflights(self) -> range:
        """Indices of the re-flights asked for."""
        return range(self.first + 1, self.first + self.asked + 1)

    @property
    def reflown_all(self) -> bool:
        """Whether every re-flight asked for has ended."""
        return all(index in self.flights and self.flights[index].settled for index in self.reflights)


def violated_verdicts(judgement: Judgement) -> list[Verdict]:
    """Return the violated verdicts, worst first."""
    bad = [verdict for verdict in judgement.verdicts if verdict.outcome == "violated"]
    return sorted(bad, key=lambda verdict: (verdict.margin, verdict.policy))


def worst_robustness(judgement: Judgement) -> float | None:
    """Return the least robustness over the policies, None if no rule applied."""
    verdict = worst(judgement)
    return None if verdict is None else verdict.robustness


def reflights_wanted(trial: Trial, needed: int) -> int:
    """Return how many re-flights more it takes at least to decide on all violations of a test case, 0 if they are.

    One that has failed `needed` times is confirmed however the rest would end, one that cannot come to that any more is
    not: flying on would only narrow the interval of its rate (curtailed inspection).
    """
    assert trial.judgement is not None, f"{trial.name} was not judged"
    judged = [note for index in trial.reflights if (note := trial.flights[index]).judged]
    left, wanted = trial.confirm_max - trial.asked, 0
    for verdict in violated_verdicts(trial.judgement):
        again = sum(verdict.policy in note.violated for note in judged)
        if again < needed <= again + left:
            refuted_after = trial.confirm_max - needed + 1 - (len(judged) - again)
            wanted = max(wanted, min(needed - again, refuted_after), 1)
    return wanted


def confirmation_of(reflown: int, again: int, asked: int, needed: int) -> Confirmation:
    """Return what `again` failures in `reflown` re-flights make of a violation, of `asked` at most.

    `unconfirmed` where too few re-flights could be flown to say, `flaky` where they were flown and did not fail
    often enough.
    """
    if reflown and again >= needed:
        return "confirmed"
    if reflown == 0 or again + (asked - reflown) >= needed or asked < needed:
        return "unconfirmed"
    return "flaky"


def violations_of(trial: Trial, rule: RepeatRule) -> tuple[Violation, ...]:
    """Return the violations of a test case whose re-flights have all ended, worst first, each with its confirmation."""
    assert trial.judgement is not None, f"{trial.name} was not judged"
    flights = [note for index, note in sorted(trial.flights.items()) if index >= trial.first]
    repeats = [note for note in flights[1:] if note.judged]
    workers = tuple(note.flight.worker for note in flights if note.judged)
    found = []
    for verdict in violated_verdicts(trial.judgement):
        broken = [note.violated[verdict.policy] for note in repeats if verdict.policy in note.violated]
        margins, again = [one.robustness for one in broken], len(broken)
        rate = wilson(again, len(repeats))
        found.append(
            msgspec.structs.replace(
                _violation(trial, verdict),
                confirmation=confirmation_of(len(repeats), again, trial.confirm_max, rule.needed),
                reflown=len(repeats),
                failed_again=again,
                rate_low=_rounded(rate.low),
                rate_high=_rounded(rate.high),
                again_low=min(margins, default=None),
                again_high=max(margins, default=None),
                hard_again=sum(one.is_hard for one in broken),
                flight_index=trial.first,
                workers=workers,
                message="; ".join(filter(None, (verdict.message, _not_reflown(flights[1:])))),
            )
        )
    return tuple(found) if trial.shrunk_from is None else _smallest_form(trial, trial.shrunk_from, found)


def similar_ones(trial: Trial, representatives: Mapping[str, str]) -> tuple[Violation, ...]:
    """Return the violations of a test case all of whose behaviours others have confirmed, worst first.

    `representatives` names these others, by fingerprint.
    """
    assert trial.judgement is not None, f"{trial.name} was not judged"
    found = (_violation(trial, verdict) for verdict in violated_verdicts(trial.judgement))
    return tuple(msgspec.structs.replace(one, representative=representatives[one.fingerprint]) for one in found)


def _violation(trial: Trial, verdict: Verdict) -> Violation:
    """Return what a violation is before anything is flown again."""
    return Violation(
        fingerprint=trial.behaviours.get(verdict.policy, ""),
        test_case=trial.name,
        policy=verdict.policy,
        robustness=verdict.margin,
        severity=verdict.severity,
        confirmation="similar",
        flight_index=trial.first,
        behaviour=verdict.behaviour,
        workers=(trial.flights[trial.first].flight.worker,),
        message=verdict.message,
    )


def _rounded(rate: float | None) -> float | None:
    """Return a rate without the digits in which versions of a library may differ: a replay comes to the same."""
    return None if rate is None else round(rate, 6)


def _not_reflown(repeats: list[FlightNote]) -> str:
    """Return in words why re-flights are missing, empty if none is."""
    missing = [note.flight.message or note.flight.ending for note in repeats if note.given_up]
    return f"{len(missing)} of {len(repeats)} re-flights could not be flown: {missing[0]}" if missing else ""


def _smallest_form(trial: Trial, larger: Violation, found: list[Violation]) -> tuple[Violation, ...]:
    """Return the violation it was shrunk for, of the behaviour it has already; others are not its matter."""
    text = f"smallest form of {larger.test_case}, {len(trial.test_case.stimuli)} inputs: "
    same = [violation for violation in found if violation.policy == larger.policy]
    named = {"fingerprint": larger.fingerprint}
    return tuple(msgspec.structs.replace(one, message=text + one.message, **named) for one in same)
