"""Planted bugs: the books with one thing broken each. If the farm's checks let one through, the checks are at fault.

Each is a context that breaks the code for as long as it is open. One that no longer fits what it breaks is no catch:
`_patched` asserts that it takes the same parameters, `is_stale` tells a mistake of its own from one that was caught,
`never_ran` tells what nothing calls any more.
"""

from __future__ import annotations

import functools
import inspect
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from saflite.campaign.engine import state
from saflite.campaign.engine.core import Core
from saflite.campaign.engine.journal import Granted, Line, Pick
from saflite.campaign.engine.outbox import Outbox
from saflite.campaign.engine.state import Books
from saflite.campaign.engine.worker_registry import WorkerRegistry
from saflite.campaign.lifecycle import confirmation, flights, repeat_checks
from saflite.campaign.lifecycle.minimization import Minimization
from saflite.campaign.lifecycle.proposals import Proposals
from saflite.campaign.scheduling import result_validation, work_messages
from saflite.campaign.scheduling.dispatch import Dispatch
from saflite.campaign.scheduling.leases import Leases
from saflite.campaign.scheduling.rounds import Plan, Round, Rounds
from saflite.campaign.scheduling.tasks import Task
from saflite.campaign.scheduling.work_keys import FlyKey, MutateKey, ScoreKey, read_key
from saflite.contract.blobs import BlobRef
from saflite.contract.join import Join
from saflite.contract.work import Outcome, Report
from saflite.runtime.books_service import BooksService

Bug = Callable[[], Any]

RAN: dict[str, int] = {}
"""How often the code of each bug planted at the moment has run."""


@contextmanager
def _patched(owner: Any, name: str, new: Any) -> Iterator[None]:
    old = owner.__dict__[name] if isinstance(owner, type) else getattr(owner, name)
    assert _parameters(old) == _parameters(new), f"{name}{_parameters(old)} is planted as {_parameters(new)}: stale"
    RAN[name] = 0
    setattr(owner, name, _counted(name, new))
    try:
        yield
    finally:
        setattr(owner, name, old)
        RAN.pop(name, None)


def _counted(name: str, new: Any) -> Any:
    function: Any = new.fget if isinstance(new, property) else new

    @functools.wraps(function)
    def counted(*args: Any) -> Any:
        RAN[name] = RAN.get(name, 0) + 1
        return function(*args)

    return property(counted) if isinstance(new, property) else counted


def never_ran() -> list[str]:
    """Return which planted code has not run since it was planted: nothing calls it any more, so it broke nothing."""
    return sorted(name for name, runs in RAN.items() if not runs)


def _parameters(thing: Any) -> list[str]:
    function: Any = thing.fget if isinstance(thing, property) else thing
    return list(inspect.signature(function).parameters)


def is_stale(fault: BaseException, file: str = __file__) -> bool:
    """Return whether it was the planted code itself (in `file`) that broke: it no longer fits the code around it."""
    frames = traceback.extract_tb(fault.__traceback__)
    mistaken = isinstance(fault, TypeError | AttributeError | NameError | ImportError)
    return mistaken and Path(frames[-1].filename) == Path(file)


def answers_before_commit() -> Any:
    """Receipts and grants go out before the commit that covers them."""
    settle = BooksService._settle

    def early(self: BooksService, now_s: float) -> None:
        outbox, self._outbox = self._outbox, []
        for request, message in outbox:
            request.reply(msgspec.msgpack.encode(message))
        settle(self, now_s)

    return _patched(BooksService, "_settle", early)


def rounds_under_way_cost_nothing() -> Any:
    """The budget does not reserve flights for rounds that have not ended."""
    return _patched(Plan, "reserved", property(lambda self: 0))


def leases_never_end() -> Any:
    """A lease whose worker fell silent is not taken back."""
    return _patched(Leases, "due", lambda self, now_s: [])


def every_flight_counts_as_a_repeat() -> Any:
    """A flight flown over again is taken as a repeat without comparing traces."""
    return _patched(repeat_checks, "same_flight", lambda first, again: True)


def reflights_fly_the_same_noise() -> Any:
    """A violation is confirmed by flying the same flight over and over."""

    def fly(self: work_messages.WorkMessages, key: FlyKey) -> Any:
        return msgspec.structs.replace(original(self, key), noise=0)

    original = work_messages.WorkMessages._fly
    return _patched(work_messages.WorkMessages, "_fly", fly)


def a_reflight_on_another_build_counts() -> Any:
    """Which build a re-flight was on is not looked at."""

    def take(self: flights.Flights, task: Task, key: FlyKey, flight: Any) -> None:
        trial = self._trial(key)
        if key.index > trial.first:
            flight = msgspec.structs.replace(flight, build=trial.build)
        original(self, task, key, flight)

    original = flights.Flights._take
    unchecked = _patched(result_validation, "_check_build", lambda task, key, flight: None)
    return _both(unchecked, _patched(flights.Flights, "_take", take))


def one_flight_of_a_smaller_test_case_is_remembered_as_truth() -> Any:
    """What the first flight of a smaller test case showed stands for all others of it."""

    def known(self: Minimization, key: FlyKey) -> frozenset[str] | None:
        return original(self, msgspec.structs.replace(key, index=0))

    original = Minimization._known
    return _patched(Minimization, "_known", known)


def one_flight_is_proof_enough() -> Any:
    """Every violation is called confirmed."""

    return _patched(confirmation, "confirmation_of", lambda reflown, again, asked, needed: "confirmed")


def attempts_without_end() -> Any:
    """A test case that takes workers down is never set aside."""

    return _patched(flights, "is_enough", lambda task, limits: False)


def the_mutator_is_told_too_early() -> Any:
    """Outcomes are told as they come, not round by round."""

    def mutate(self: work_messages.WorkMessages, key: MutateKey, cursor: int) -> Any:
        work = original(self, key, cursor)
        early = tuple(
            outcome
            for number, round_ in sorted(self._core.rounds.under_way.items())
            if number > work.cursor
            for outcome in round_.told()
        )
        if not early:
            return work
        moved = [msgspec.structs.replace(outcome, round=max(work.cursor, 0)) for outcome in early]
        return msgspec.structs.replace(work, outcomes=(*work.outcomes, *moved), cursor=max(work.cursor, 0))

    original = work_messages.WorkMessages._mutate
    return _patched(work_messages.WorkMessages, "_mutate", mutate)


def outcomes_in_order_of_arrival() -> Any:
    """Outcomes are told in the order in which flights ended."""

    def told(self: Round) -> tuple[Outcome, ...]:
        return tuple(self.outcomes.values())

    return _patched(Round, "told", told)


def old_test_cases_fly_again() -> Any:
    """What was flown before is not left out of the choice."""

    def choose(self: Books, now: float) -> None:
        flown, self._core.flown = self._core.flown, {}
        try:
            original(self, now)
        finally:
            self._core.flown = {**flown, **self._core.flown}

    original = Books._choose
    return _patched(Books, "_choose", choose)


def a_lost_batch_is_forgotten() -> Any:
    """A batch no scorer could score is dropped with its test cases."""

    def trouble(self: Proposals, task: Task, key: ScoreKey, message: str) -> None:
        self._core.done(task, "failed", message)

    return _patched(Proposals, "on_score_trouble", trouble)


def any_score_will_do() -> Any:
    """Scores are not checked against the work."""

    return _patched(result_validation, "_check_scores", lambda task, result, names: None)


def grants_are_not_written_down() -> Any:
    """The journal leaves grants out."""

    def line(self: Outbox, data: bytes) -> None:
        entry = msgspec.msgpack.Decoder(Line).decode(data).entry
        if not isinstance(entry, Granted):
            original(self, data)

    original = Outbox.line
    return _patched(Outbox, "line", line)


def facts_are_numbered_anew_after_a_restart() -> Any:
    """The sequence of facts begins again when the books are opened."""

    def begin(self: Books, now: float, unix_s: float) -> None:
        self._out.seq = 0
        original(self, now, unix_s)

    original = Books.begin
    return _patched(Books, "begin", begin)


def the_trace_goes_too_soon() -> Any:
    """A trace is dropped when its flight is taken, not when it was judged."""

    def hold(self: Core, *blobs: BlobRef) -> None:
        original(self, *blobs)
        for blob in blobs:
            self.out.drop_blob(blob.digest)

    original = Core.hold
    return _patched(Core, "hold", hold)


def leases_are_forgotten_over_a_restart() -> Any:
    """Leases under way get no new deadline when the books are opened again."""

    def begin(self: Books, now: float, unix_s: float) -> None:
        original(self, now, unix_s)
        for key in self._leases.keys():  # noqa: SIM118 (a copy)
            self._leases.end(key)

    original = Books.begin
    return _patched(Books, "begin", begin)


@contextmanager
def anybody_may_report() -> Iterator[None]:
    """A result is taken from whoever sends it, under whatever epoch."""

    def claim(self: Dispatch, report: Report, run: str) -> Any:
        key = read_key(report.lease_id.partition(":")[2])
        task = None if key is None else self._core.tasks.get(key)
        return original(self, report, run) if task is None or task.waiting else task

    def take(self: Books, task: Task, report: Report, now: float, damage: str) -> Any:
        return taken(self, task, msgspec.structs.replace(report, epoch=task.epoch), now, damage)

    original, taken = Dispatch.claim, Books._take
    with _patched(Dispatch, "claim", claim), _patched(Books, "_take", take):
        yield


def anybody_may_ask() -> Any:
    """Whoever asks for work or sends a heartbeat is taken for one who has joined."""

    def met(self: WorkerRegistry, stage: Any, worker: str, session: str, now_s: float) -> bool:
        if self.get(stage, worker) is None:
            self.join(Join(protocol=0, worker=worker, session=session, stage=stage), now_s)
        return True

    return _patched(WorkerRegistry, "met", met)


def a_result_is_counted_each_time_it_comes() -> Any:
    """Work that was reported stays to be done."""

    def done(self: Core, task: Task, how: str, message: str = "") -> None:
        if task.stage == "fly" and how == "completed":
            self.tasks.requeue(task)
        else:
            original(self, task, how, message)

    original = Core.done
    return _patched(Core, "done", done)


def announced_twice() -> Any:
    """A violation is announced twice."""

    def announce(self: flights.Flights, trial: Any, violation: Any) -> None:
        original(self, trial, violation)
        original(self, trial, violation)

    original = flights.Flights._announce
    return _patched(flights.Flights, "_announce", announce)


def chosen_by_order_of_arrival() -> Any:
    """The choice prefers candidates whose scores came first."""

    def select(candidates: Any, scores: Any, flown: Any, rules: Any, expected: Any) -> Any:
        names = list(scores)[: rules.flights]
        return tuple(Pick(test_case=name, selected_by="score", score=scores[name], novelty=0.0) for name in names)

    def choose(self: Books, now: float) -> None:
        for round_ in self._core.rounds.under_way.values():
            round_.candidates = {name: round_.candidates[name] for name in [*round_.scores, *round_.candidates]}
        original(self, now)

    original = Books._choose
    return _both(_patched(state, "select", select), _patched(Books, "_choose", choose))


def planned_on_what_happens_to_be_known() -> Any:
    """A round is planned on the costs known at the moment instead of those of rounds up to r - lag."""

    def close(self: Rounds, number: int) -> None:
        closing = self.under_way[number]
        original(self, number)
        self._costs[number] = (closing.cost, closing.cost)

    original = Rounds.close
    return _patched(Rounds, "close", close)


@contextmanager
def _both(first: Any, second: Any) -> Iterator[None]:
    with first, second:
        yield


BUGS: dict[str, Bug] = {
    bug.__name__: bug
    for bug in (
        answers_before_commit,
        rounds_under_way_cost_nothing,
        leases_never_end,
        every_flight_counts_as_a_repeat,
        reflights_fly_the_same_noise,
        one_flight_is_proof_enough,
        a_reflight_on_another_build_counts,
        one_flight_of_a_smaller_test_case_is_remembered_as_truth,
        attempts_without_end,
        the_mutator_is_told_too_early,
        outcomes_in_order_of_arrival,
        old_test_cases_fly_again,
        a_lost_batch_is_forgotten,
        any_score_will_do,
        grants_are_not_written_down,
        facts_are_numbered_anew_after_a_restart,
        the_trace_goes_too_soon,
        leases_are_forgotten_over_a_restart,
        anybody_may_report,
        anybody_may_ask,
        a_result_is_counted_each_time_it_comes,
        announced_twice,
        chosen_by_order_of_arrival,
        planned_on_what_happens_to_be_known,
    )
}
