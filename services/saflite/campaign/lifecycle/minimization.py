"""Flies what the minimizer asks for. These flights count against no budget and no round waits for them.

What they tell goes down with every further find of a policy, so the first behaviour of each has most of them, and at
once as many as make most finds small. All others wait until no flight of the search does, and begin with the inputs
that were enough for the first find of the policy: two behaviours often have one cause.

The smallest test case that still violates is then flown as a test case of its own, with re-flights and recording.
"""

from __future__ import annotations

from dataclasses import dataclass

from saflite.campaign.engine.core import Core
from saflite.campaign.lifecycle.confirmation import Trial
from saflite.campaign.lifecycle.minimizer import Minimizer, names_of
from saflite.campaign.lifecycle.repeats import shrink_flights_max, shrink_rule
from saflite.campaign.scheduling.tasks import Task, is_enough
from saflite.campaign.scheduling.work_keys import FlightKey, FlyKey, JudgeKey
from saflite.contract.circumstances import ranges_kept
from saflite.contract.flight import FLOWN_ENDINGS, Flight
from saflite.contract.test_case import TestCase, identity
from saflite.contract.verdict import Violation
from saflite.contract.work import FlyResult, JudgeResult, TargetBuild

AFTER_REFLIGHTS = 10**6
"""Place of these flights in the order of the work for one test case: behind any re-flight."""
AFTER_SEARCH = 10**9
"""Place of those that can wait in the order of all work: behind every round."""
AT_ONCE = 30
"""Flights of a policy's first behaviour that do not wait."""


@dataclass(slots=True)
class MinimizationCandidate:
    """A violation being made smaller."""

    trial: Trial
    violation: Violation
    minimizer: Minimizer
    waits_below: int  # flights left to it: with fewer, they wait until the search has nothing to fly
    leads: bool  # it is the first find of its policy


@dataclass(slots=True)
class Follower:
    """A violation to be made smaller once the first find of its policy was."""

    trial: Trial
    violation: Violation
    is_first: bool


@dataclass(slots=True)
class Attempt:
    """One flight of a smaller test case, under way."""

    test_case: TestCase
    build: str
    flight: Flight | None = None
    traces_lost: int = 0  # before they were judged


class Minimization:
    """All shrinking under way. What one flight showed is known to all of them, in whatever order they ask."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._candidates: list[MinimizationCandidate] = []
        self._followers: list[Follower] = []
        self._enough: dict[str, frozenset[str]] = {}  # by policy: inputs of its first find, made small; maybe none
        self._under_way: dict[FlyKey, Attempt] = {}
        self._shown: dict[FlyKey, frozenset[str]] = {}

    @property
    def candidates(self) -> int:
        """How many violations are being made smaller, or will be."""
        return len(self._candidates) + len(self._followers)

    def test_case(self, key: FlightKey) -> TestCase:
        """Return the test case of a flight under way."""
        return self._under_way[_flying(key)].test_case

    def flight(self, key: JudgeKey) -> Flight:
        """Return the flight to be judged."""
        flight = self._under_way[key.flying].flight
        assert flight is not None, f"{key} is to be judged but was not flown"
        return flight

    # ---- beginning and end ---------------------------------------------------------------------------------------

    def begin(self, trial: Trial, violation: Violation, *, is_first: bool, leads: bool) -> None:
        """Begin to make a confirmed violation smaller, if the campaign wants that and there is anything to drop.

        `is_first`: of the behaviours that violate its policy it is the first found. `leads`: it is the first find of
        its policy; the others wait for that one. Which finds lead does not depend on what comes back first.
        """
        if not self._core.campaign.search.shrink or not trial.test_case.stimuli:
            if leads:
                self.lead(violation.policy, None)
        elif leads or violation.policy in self._enough:
            self._take_up(Follower(trial, violation, is_first), leads=leads)
        else:
            self._followers.append(Follower(trial, violation, is_first))

    def lead(self, policy: str, smallest: TestCase | None) -> None:
        """Note the smallest form of the first find of a policy; None: it was not confirmed, or is as it was."""
        self._enough[policy] = frozenset() if smallest is None else names_of(smallest)
        ready = [one for one in self._followers if one.violation.policy == policy]
        self._followers = [one for one in self._followers if one not in ready]
        for follower in ready:
            self._take_up(follower, leads=False)

    def _take_up(self, one: Follower, *, leads: bool) -> None:
        rule, policy = shrink_rule(self._core.confirm), one.violation.policy
        most = shrink_flights_max(self._core.campaign.search, rule, is_first=one.is_first)
        shown_s, enough = _shown_s(one.trial, policy), self._enough.get(policy, frozenset())
        ranges = ranges_kept(one.trial.test_case, self._core.target)
        minimizer = Minimizer(one.trial.test_case, most, rule, shown_s, enough, ranges)
        waits_below = most - AT_ONCE * rule.flights if one.is_first else most + 1
        self._candidates.append(MinimizationCandidate(one.trial, one.violation, minimizer, waits_below, leads))

    def advance(self) -> list[MinimizationCandidate]:
        """Ask for the flights every candidate needs next; returns and forgets those that are done."""
        finished: list[MinimizationCandidate] = []
        while done := [candidate for candidate in self._candidates if self._is_done(candidate)]:
            self._candidates = [candidate for candidate in self._candidates if candidate not in done]
            for candidate in done:
                if candidate.leads:
                    self.lead(candidate.violation.policy, candidate.minimizer.best)
            finished += done
        return finished

    def _is_done(self, candidate: MinimizationCandidate) -> bool:
        while asked := candidate.minimizer.ask():
            keys = {FlyKey(identity(one.test_case), "shrink", one.number): one.test_case for one in asked}
            shown = {key: violated for key in keys if (violated := self._known(key)) is not None}
            if not shown:
                for key, case in keys.items():
                    self._fly(candidate, key, case)
                return False
            for key, violated in shown.items():
                candidate.minimizer.tell(key.test_case, key.index, candidate.violation.policy in violated)
        return True

    def _known(self, key: FlyKey) -> frozenset[str] | None:
        """Return the policies this very flight violated, None while it has shown nothing."""
        return self._shown.get(key)

    def _fly(self, candidate: MinimizationCandidate, key: FlyKey, test_case: TestCase) -> None:
        if key in self._under_way:
            return
        self._under_way[key] = Attempt(test_case, candidate.trial.build)
        after = AFTER_SEARCH if candidate.minimizer.left < candidate.waits_below else 0
        order = (after + candidate.trial.round, candidate.trial.rank, AFTER_REFLIGHTS, 0)
        self._core.tasks.add(Task(key, order, target=TargetBuild(test_case.target.name, candidate.trial.build)))

    def validate(self) -> None:
        """Assert that every candidate rests on as many flights as its rule asks for, each shown by one of its own."""
        for candidate in self._candidates:
            candidate.minimizer.validate()
            name, policy, rule = (
                identity(candidate.minimizer.best),
                candidate.violation.policy,
                candidate.minimizer.rule,
            )
            keys = (FlyKey(name, "shrink", index) for index in range(rule.flights))
            failed = sum(1 for key in keys if policy in self._shown.get(key, ()))
            assert name == candidate.minimizer.original or failed >= rule.needed, (
                f"{name} is taken to violate {policy} after {failed} flights that did, {rule.needed} are needed"
            )

    # ---- what comes back -----------------------------------------------------------------------------------------

    def on_flown(self, task: Task, key: FlyKey, result: FlyResult) -> None:
        """Have a flight judged."""
        core, flight = self._core, result.flight
        if flight.ending not in FLOWN_ENDINGS:
            again = self.on_failure if flight.ending == "infra" else self.on_lost
            again(task, key, flight.message or flight.ending)
            return
        core.done(task, flight.ending, flight.message)
        core.counts.shrink_flights += 1
        self._under_way[key].flight = flight
        core.hold(*flight.blobs)
        core.note_flight(flight, key.purpose)
        core.tasks.add(Task(key.judging, (*task.order[:3], 1)))

    def on_judged(self, task: Task, key: JudgeKey, result: JudgeResult) -> None:
        """Note which policies a flight violated."""
        self._core.done(task, "judged")
        bad = (verdict.policy for verdict in result.judgement.verdicts if verdict.outcome == "violated")
        self._show(key.flying, frozenset(bad))

    def on_lost(self, task: Task, key: FlightKey, message: str) -> None:
        """The worker vanished with the work, or nothing came of it in time."""
        task.losses += 1
        self._try_again(task, key, "lost", message)

    def on_nobody(self, task: Task, key: FlightKey, message: str) -> None:
        """Nobody is there who could fly it."""
        self._give_up(task, key, "infra", message)

    def on_failure(self, task: Task, key: FlightKey, message: str) -> None:
        """Our side could not fly or judge."""
        task.failures += 1
        self._try_again(task, key, "infra", message)

    def _try_again(self, task: Task, key: FlightKey, how: str, message: str) -> None:
        if is_enough(task, self._core.campaign.lease):
            self._give_up(task, key, how, message)
        else:
            self._core.again(task, how, message)

    def _give_up(self, task: Task, key: FlightKey, how: str, message: str) -> None:
        """What cannot be flown or judged is taken as held: it shows no violation."""
        self._core.fault(str(key), f"given up, taken as held: {message or how}")
        self._core.done(task, how, message)
        self._show(_flying(key), frozenset())

    def on_trace_missing(self, task: Task, key: JudgeKey, message: str) -> None:
        """Fly again what left no trace to be judged by, unless that happens again and again."""
        self._let_go(key.flying)
        attempt = self._under_way[key.flying]
        attempt.traces_lost += 1
        if attempt.traces_lost >= self._core.campaign.lease.attempts_max:
            self._give_up(task, key, "infra", f"its trace was lost {attempt.traces_lost} times: {message}")
            return
        self._core.done(task, "trace_missing", message)
        target = TargetBuild(attempt.test_case.target.name, attempt.build)
        self._core.tasks.add(Task(key.flying, (*task.order[:3], 0), target=target))

    def _show(self, key: FlyKey, violated: frozenset[str]) -> None:
        self._let_go(key)
        del self._under_way[key]
        self._shown[key] = violated

    def _let_go(self, key: FlyKey) -> None:
        attempt = self._under_way[key]
        if attempt.flight is not None:
            self._core.let_go(*attempt.flight.blobs)
            attempt.flight = None


def _shown_s(trial: Trial, policy: str) -> float | None:
    """Return by when the first flight showed the violation, None if nobody told."""
    assert trial.judgement is not None, f"{trial.name} was not judged"
    return next((one.witness_to_s for one in trial.judgement.verdicts if one.policy == policy), 0.0) or None


def _flying(key: FlightKey) -> FlyKey:
    return key if isinstance(key, FlyKey) else key.flying
