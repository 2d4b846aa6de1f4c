"""Does the farm repeat flights bit by bit? A sample of first flights is flown over again elsewhere and compared.

A check of the farm itself and of what the target says of itself: it counts against no budget, no test case and no
round waits for it, and nothing that is found depends on it. The first confirmed find of each policy is flown over
again besides: that it repeats bit by bit is what its maintainers ask first. `saflite replay` does it for all.
"""

from __future__ import annotations

from saflite.campaign.engine.core import Core
from saflite.campaign.lifecycle.confirmation import Trial
from saflite.campaign.scheduling.tasks import Task, is_enough
from saflite.campaign.scheduling.work_keys import FlightKey, FlyKey, JudgeKey
from saflite.contract.flight import FLOWN_ENDINGS, Flight
from saflite.contract.rng import derive_seed
from saflite.contract.test_case import TestCase, draw_key
from saflite.contract.work import FlyResult, JudgeResult, TargetBuild

AFTER_ALL = 10**9
"""Place of these flights in the order of all work: behind whatever the search asks for."""


class RepeatChecks:
    """The checks under way: test case and first flight of each."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._under_way: dict[FlyKey, tuple[TestCase, Flight]] = {}

    def offer(self, trial: Trial, first: Flight) -> None:
        """Take a first flight into the sample, or not; the first one of a campaign always is in it."""
        core, share = self._core, self._core.campaign.search.check_share
        if core.target.repeats != "bitwise" or not trial.is_selected or not first.trace_digest or not share:
            return
        drawn = derive_seed(core.campaign.rng_seed, "check", draw_key(trial.test_case)) / 2**63
        if drawn < share or (trial.round, trial.rank) == (0, 0):
            self._ask(trial, first)

    def prove(self, trial: Trial) -> None:
        """Have a confirmed find flown over again, if it was not: maintainers ask whether it repeats bit by bit."""
        core, first = self._core, trial.flights[trial.first].flight
        if core.target.repeats == "bitwise" and core.campaign.search.check_share and not trial.first:
            self._ask(trial, first)

    def _ask(self, trial: Trial, first: Flight) -> None:
        core, key = self._core, FlyKey(trial.name, "check", 0)
        if trial.checked or key in self._under_way:
            return  # as a sample, for its first flight was flown once more (its trace was lost), or as a smallest form
        trial.checked = True
        self._under_way[key] = trial.test_case, first
        target = TargetBuild(trial.test_case.target.name, first.build)
        order = (AFTER_ALL, trial.round, trial.rank, 0)
        core.tasks.add(Task(key, order, target=target, avoid=frozenset({first.worker})))

    def test_case(self, key: FlightKey) -> TestCase:
        """Return the test case of a flight under way."""
        assert isinstance(key, FlyKey), f"{key} is not judged"
        return self._under_way[key][0]

    def flight(self, key: JudgeKey) -> Flight:
        """These flights are not judged."""
        raise AssertionError(f"{key} is not judged")

    def on_flown(self, task: Task, key: FlyKey, result: FlyResult) -> None:
        """Compare."""
        core, again = self._core, result.flight
        if again.ending not in FLOWN_ENDINGS:
            lost = self.on_failure if again.ending == "infra" else self.on_lost
            lost(task, key, again.message or again.ending)
            return
        core.done(task, again.ending, again.message)
        test_case, first = self._under_way.pop(key)
        core.counts.checked += 1
        core.note_flight(again, key.purpose)
        if not same_flight(first, again):
            core.counts.unequal += 1
            core.fault(str(key), _unequal(test_case.target.name, first, again))

    def on_judged(self, task: Task, key: JudgeKey, result: JudgeResult) -> None:
        """These flights are not judged."""
        raise AssertionError(f"{key} is not judged")

    def on_trace_missing(self, task: Task, key: JudgeKey, message: str) -> None:
        """These flights are not judged."""
        raise AssertionError(f"{key} is not judged")

    def on_lost(self, task: Task, key: FlightKey, message: str) -> None:
        """The worker vanished with the work, or nothing came of it in time."""
        task.losses += 1
        self._try_again(task, key, "lost", message)

    def on_failure(self, task: Task, key: FlightKey, message: str) -> None:
        """Our side could not fly it."""
        task.failures += 1
        self._try_again(task, key, "infra", message)

    def on_nobody(self, task: Task, key: FlightKey, message: str) -> None:
        """Nobody is there who could fly it: one check less."""
        assert isinstance(key, FlyKey), f"{key} is not judged"
        del self._under_way[key]
        self._core.done(task, "infra", message)

    def _try_again(self, task: Task, key: FlightKey, how: str, message: str) -> None:
        if is_enough(task, self._core.campaign.lease):
            self.on_nobody(task, key, message or how)
        else:
            self._core.again(task, how, message)


def same_flight(first: Flight, again: Flight) -> bool:
    """Whether two flights ended the same, were given the same and left bit-equal traces."""
    mine = (first.ending, first.delivered, first.trace_digest)
    return mine == (again.ending, again.delivered, again.trace_digest)


def _unequal(target: str, first: Flight, again: Flight) -> str:
    """Return in words that a flight was no repeat."""
    return (
        f"{target} says that it repeats bit by bit, but on the same build a flight by {again.worker} ended"
        f" {again.ending} with trace {again.trace_digest[:16] or 'none'}, after {first.ending} with trace"
        f" {first.trace_digest[:16] or 'none'} by {first.worker}"
    )
