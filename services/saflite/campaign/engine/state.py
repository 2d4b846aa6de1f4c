"""The books: a pure state machine. Asks, reports, heartbeats, orders and time in; answers, and batches to commit, out.

Nothing here waits, reads a clock or touches a disk. Every change is a journal line applied by the reducer; the shell
drains a batch, commits it, and only then sends the answers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from saflite.campaign.engine import snapshot
from saflite.campaign.engine.core import Core
from saflite.campaign.engine.invariants import validate
from saflite.campaign.engine.journal import (
    Entry,
    GaveUp,
    Granted,
    How,
    Line,
    Noted,
    Opened,
    Ordered,
    Pruned,
    Returned,
    Selected,
    Settled,
    TraceMissing,
    decode_line,
    encode_line,
)
from saflite.campaign.engine.outbox import Batch, Outbox
from saflite.campaign.engine.read_model import NothingToRead, ReadModel
from saflite.campaign.engine.reducer import Reducer
from saflite.campaign.engine.status import Rates, status_of
from saflite.campaign.engine.worker_registry import WorkerRegistry
from saflite.campaign.lifecycle import retention
from saflite.campaign.lifecycle.repeats import confirm_rule
from saflite.campaign.scheduling.dispatch import Dispatch
from saflite.campaign.scheduling.leases import Deadline, Leases
from saflite.campaign.scheduling.patience import Patience
from saflite.campaign.scheduling.result_validation import SAID_MAX, check_result, too_much_left
from saflite.campaign.scheduling.rounds import Rounds
from saflite.campaign.scheduling.selection import Expected, Rules, select
from saflite.campaign.scheduling.tasks import Task, is_uncounted_too_often
from saflite.campaign.scheduling.work_keys import JudgeKey, WorkKey, run_and_key
from saflite.campaign.scheduling.work_messages import WorkMessages, in_one_message, receipt_for
from saflite.contract.blobs import BlobRef
from saflite.contract.bounds import told
from saflite.contract.config import Campaign
from saflite.contract.control import Answer, Control, Status
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import BudgetChanged, FaultSeen, WorkerChanged
from saflite.contract.join import Join
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Target, TestCase
from saflite.contract.work import (
    Ask,
    Failure,
    FlyResult,
    Grant,
    HandedBack,
    Heartbeat,
    Lease,
    MutateResult,
    Orders,
    Receipt,
    Report,
    blobs_left,
)

GRANTS_MAX = 16
NOT_JOINED = "nobody of this name and session has joined since the books were opened"


class Books:
    """The books of one campaign.

    Args:
        campaign: what flies and how; never changes over the life of the campaign (orders go through `control`).
        template: the test case the strategy varies.
        target: what the target said of itself when the run was made.
        run_id: names this run of the campaign; part of every lease id, so that results of another run are recognised.
        read_model: where committed blobs, outcomes and events are read from; None keeps all of them out of reach,
            which is enough for replays and for campaigns shorter than a few rounds in tests.
    """

    def __init__(
        self,
        campaign: Campaign,
        template: TestCase,
        target: TargetInfo,
        *,
        run_id: str = "run",
        read_model: ReadModel | None = None,
    ) -> None:
        self._out = Outbox()
        confirm = confirm_rule(campaign.search, target.repeats)
        rounds = Rounds(campaign.search, campaign.budget_flights)
        self._core = Core(campaign, template, target, self._out, rounds, confirm)
        self._reducer = Reducer(self._core)
        self._read_model: ReadModel = read_model or NothingToRead()
        self._registry, self._leases = WorkerRegistry(), Leases(campaign.lease)
        self.owner_of, self.waiting_count = self._registry.owner_of, self._core.tasks.waiting_count
        self._work_messages = WorkMessages(self._reducer, self._read_model, self._registry)
        self._dispatch = Dispatch(self._core, self._registry, self._leases)
        self._patience = Patience(self._core, self._registry, self._leases)
        self._rates, self._run_id = Rates(), run_id

    @property
    def campaign(self) -> Campaign:
        """The campaign these are the books of."""
        return self._core.campaign

    @property
    def target(self) -> Target:
        """What the campaign's test cases fly on."""
        return self._core.template.target

    @property
    def ended(self) -> bool:
        """Whether the campaign is over (budget spent, nothing left to propose, or stopped)."""
        return self._core.state == "ended"

    @property
    def lease_s(self) -> float:
        """How long a lease granted now runs without a heartbeat."""
        return self._leases.lease_s

    @property
    def wanted_blobs(self) -> frozenset[BlobRef]:
        """The blobs some flight or recording needs; any other is left over from an interrupted commit."""
        return frozenset(BlobRef(digest=name, size_bytes=hold.size_bytes) for name, hold in self._core.holds.items())

    def audit_status(self) -> dict[str, Any]:
        """Return what an audit needs to know; `over`: ended for good, not by an operator's order."""
        core = self._core
        return {"state": core.state, "over": self.ended and not core.stopped, "budget": core.rounds.budget}

    def replay(self, line: bytes, *, announce: bool = False) -> None:
        """Apply a committed journal line again; with `announce` its facts can be drained. Before `begin` only."""
        self._out.replaying = not announce
        self._reducer.apply(decode_line(line))
        self._out.line(line)
        self._out.replaying = False

    def snapshot(self) -> bytes:
        """Return the state of the fold, once all was drained. Equal journals give equal bytes."""
        return snapshot.take(self._reducer)

    def restore(self, data: bytes) -> None:
        """Take a snapshot's state in place of a replay up to it; raises ValueError if it is none of these books."""
        snapshot.put_back(self._reducer, data)

    def begin(self, now: float, unix_s: float) -> None:
        """Open the books at `now` on their clock: leases under way get their full time again."""
        self._do(Opened(incarnation=self._core.incarnation + 1, unix_s=unix_s), now)
        leased = self._core.tasks.leased()
        lease_s = self._leases.lease_of(len({task.worker for task in leased}))
        for task in leased:
            self._start_clock(task, lease_s, now)
        self._registry.remember(self._core.members)
        self._fly_again_what_left_no_trace(now)
        self._choose(now)

    def prune(self, blobs: frozenset[BlobRef], recordings: tuple[tuple[str, int], ...]) -> None:
        """Let go of blobs, those excepted that work under way needs, and of the names that recordings have."""
        blobs &= self.wanted_blobs - retention.needed(self._core, self._reducer.flight_of)
        self._do(Pruned(blobs=tuple(sorted(blobs, key=str)), recordings=recordings), self._core.at_s)

    def drain(self) -> Batch:
        """Return all that changed since the last call; to be committed before any answer is sent."""
        return self._out.drain()

    def _do(self, entry: Entry, now: float) -> None:
        placed = self._reducer.apply(Line(now, entry))
        self._out.line(encode_line(Line(now, entry, placed)))

    def _fly_again_what_left_no_trace(self, now: float) -> None:
        for key in [task.key for task in self._core.tasks if isinstance(task.key, JudgeKey)]:
            trace = self._reducer.flight_of(key).trace
            if trace is not None and self._read_model.blob_fault(trace, deep=True):
                self._without_its_trace(key, "its trace was not on disk", now)

    def _without_its_trace(self, key: WorkKey, message: str, now: float) -> None:
        """Fly again what cannot be judged; give up a recording that cannot be written."""
        self._leases.end(key)
        lost = TraceMissing if isinstance(key, JudgeKey) else GaveUp
        self._do(lost(key=key, message=message), now)

    # ---- work out ------------------------------------------------------------------------------------------------

    def ask(self, ask: Ask, now: float) -> Grant:
        """Hand out work, or nothing. The grant counts once it is committed."""
        if not self._registry.asks(ask, now):
            return Grant(retry_after_s=0.0, refused=NOT_JOINED)
        if self.ended:
            return Grant(stop=True)
        if not self._core.tasks.waiting_count(ask.stage):
            return Grant()
        chosen = self._dispatch.choose(ask, min(ask.leases_max, GRANTS_MAX), now)
        leases = (lease for task in chosen for lease in self._lend(task, ask, now))
        return Grant(leases=tuple(leases if len(chosen) == 1 else in_one_message(leases)))

    def _lend(self, task: Task, ask: Ask, now: float) -> list[Lease]:
        try:
            work = self._work_messages.work(task, ask.cursor)
        except Unavailable as fault:
            self._without_its_trace(task.key, str(fault), now)
            return []
        catching_up = getattr(work, "count", 1) == 0
        epoch, model = task.epoch + 1, self._work_messages.model_for(task)
        self._do(Granted(key=task.key, epoch=epoch, worker=ask.worker, model=model, catching_up=catching_up), now)
        times = {"lease_s": self._leases.lease_s, "overdue_s": self._work_messages.overdue_s(task)}
        self._start_clock(task, times["lease_s"], now)
        return [Lease(lease_id=f"{self._run_id}:{task.key}", epoch=epoch, work=work, **times)]

    def _start_clock(self, task: Task, lease_s: float, now: float) -> None:
        overdue_s = now + self._work_messages.overdue_s(task)
        self._leases.begin(Deadline(task.key, task.epoch, task.worker, lease_s, now + lease_s, overdue_s))

    def _stop_clocks(self) -> None:
        """End the leases of work an order has done away with."""
        for key in self._leases.keys():  # noqa: SIM118 (a copy)
            task = self._core.tasks.get(key)
            if task is None or task.waiting:
                self._leases.end(key)

    # ---- results in ----------------------------------------------------------------------------------------------

    def awaits(self, report: Report) -> bool:
        """Whether it is worth a look at the blobs of a result: its lease is held, and it names those that it may."""
        claimed, result = self._dispatch.claim(report, self._run_id), report.result
        if not isinstance(claimed, Task) or too_much_left(result):
            return False
        return not isinstance(result, Failure) or self._reducer.lacks_its_trace(claimed.key, result)

    def report(self, report: Report, now: float, damage: str = "") -> Receipt:
        """Take a result; the worker may forget it once it has the receipt. `damage`: what is wrong with its blobs."""
        claimed = self._dispatch.claim(report, self._run_id)
        receipt = self._take(claimed, report, now, damage) if isinstance(claimed, Task) else claimed
        for blob in blobs_left(report.result):
            if blob.digest not in self._core.holds:
                self._out.drop_blob(blob.digest)
        return receipt

    def _take(self, task: Task, report: Report, now: float, damage: str) -> Receipt:
        key, result = task.key, report.result
        self._registry.worked(task.stage, report.worker, now)
        try:
            check_result(self._core, task, report.result, damage, self._reducer.test_case_of)
        except Refused as fault:
            if task.epoch == report.epoch:
                self._give_back(task, "refused", str(fault), now)
            return receipt_for(report, "refused", str(fault))
        if isinstance(report.result, HandedBack):
            self._without_result(task, "handed_back", told(report.result.message, SAID_MAX), now)
        elif isinstance(report.result, MutateResult) and task.catching_up:
            self._without_result(task, "caught_up", "", now)
        elif isinstance(report.result, Failure) and damage and self._reducer.lacks_its_trace(key, report.result):
            self._without_its_trace(key, damage, now)
            self._choose(now)
        elif isinstance(report.result, Failure) and self._dispatch.passes_on(task, now):
            self._give_back(task, "passed_on", report.result.message, now)
        else:
            if isinstance(result, FlyResult):
                result = FlyResult(flight=msgspec.structs.replace(result.flight, worker=report.worker))
            self._leases.end(key)
            self._do(Settled(key=key, epoch=report.epoch, worker=report.worker, result=result), now)
            self._rates.settled(result, now)
            self._choose(now)
        return receipt_for(report, "accepted")

    def _without_result(self, task: Task, how: How, message: str, now: float) -> None:
        if is_uncounted_too_often(task):
            how, message = "lost", f"given back {task.epoch} times; {task.worker}: {message or how}"
        self._give_back(task, how, message, now)

    def _give_back(self, task: Task, how: How, message: str, now: float) -> None:
        if how in ("lost", "overdue", "refused") and self._dispatch.passes_on(task, now):
            how = "passed_on"
        self._leases.end(task.key)
        self._do(Returned(key=task.key, epoch=task.epoch, how=how, message=message), now)
        self._choose(now)

    def _choose(self, now: float) -> None:
        """Choose the flights of every round whose turn it is."""
        core, search = self._core, self._core.rounds.search
        while (round_ := core.rounds.next_to_select()) is not None:
            candidates = {name: case for name, case in round_.candidates.items() if name not in core.flown}
            scores, rng_seed = {name: round_.scores[name].value for name in candidates}, core.campaign.rng_seed
            rules = Rules(round_.plan.flights, search.random_share, search.novelty_weight, rng_seed, round_.number)
            picks = select(candidates, scores, tuple(core.latest), rules, Expected(round_.kinds(), core.promised))
            self._do(Selected(round=round_.number, picks=picks), now)

    # ---- who is there --------------------------------------------------------------------------------------------

    def beat(self, beat: Heartbeat, now: float) -> Orders:
        """Extend the leases named that are still the worker's; the others are to be dropped."""
        if not self._registry.met(beat.stage, beat.worker, beat.session, now):
            return Orders(refused=NOT_JOINED)
        self._registry.beat(beat, now)
        cancel = []
        for lease_id, epoch in beat.leases:
            run_id, key = run_and_key(lease_id)
            if run_id != self._run_id or key is None or not self._leases.extend(key, epoch, beat.worker, now):
                cancel.append(lease_id)
        return Orders(cancel=tuple(cancel), stop=self.ended, beat_s=self._leases.beat_s(len(self._registry)))

    def join(self, card: Join, now: float, *, owner: str = "", gone: Callable[[Join], bool] = lambda _: False) -> str:
        """Let a worker in, of the key that is its `owner` or the farm's own user; returns why not, empty if it joined.

        See `WorkerRegistry.in_the_way` for whose name or place it takes.
        """
        other = self._registry.in_the_way(card, owner, gone, self._leases.holds)
        if isinstance(other, str):
            return other
        if other is not None:
            why = "it began anew" if other.worker == card.worker else "the farm is full, others have fewer workers"
            self.absent(other.worker, other.stage, now, session=other.card.session, why=why)
        if self._registry.join(card, now, owner):
            known = {"host": card.host, "build": card.build_of(self.target.name)}
            fact = WorkerChanged(worker=card.worker, stage=card.stage, present=True, **known)
            self._do(Noted(fact=fact, key=owner), now)
        return ""

    def absent(
        self, worker: str, stage: str, now: float, *, session: str = "", why: str = "its token vanished"
    ) -> None:
        """Free the leases of a worker that is gone, at once; an earlier life of one that is back holds none."""
        known = self._registry.get(stage, worker)
        if known is None or known.card.session != session:
            return
        for place, deadline in enumerate(self._leases.held_by(stage, worker)):
            self._registry.worked(stage, worker, now)
            self._lose(deadline, "lost" if place == 0 else "undelivered", f"{worker}: {why}", now)
        self._registry.leave(stage, worker)
        self._do(Noted(fact=WorkerChanged(worker=worker, stage=stage, present=False, message=why)), now)

    def _lose(self, deadline: Deadline, how: How, message: str, now: float) -> None:
        task = self._core.tasks.get(deadline.key)
        assert task is not None, f"{deadline.key} is lent but not to be done"
        self._give_back(task, how, message, now)

    def fault(self, where: str, message: str, now: float) -> None:
        """Note trouble the farm got over, such as a message that could not be read."""
        self._do(Noted(fact=FaultSeen(where=where, message=message)), now)

    # ---- time ----------------------------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """End leases whose time is up and forget workers not heard of for long."""
        due = self._leases.due(now)
        begun = {self._leases.held_by(one.key.stage, one.worker)[0].key for one in due}
        for deadline in due:
            why, ended = deadline.ended()
            how: How = ended if deadline.named and deadline.key in begun else "undelivered"
            self._lose(deadline, how, f"{deadline.worker} {why}", now)
        for worker in self._registry.silent(now - self._leases.patience_s(len(self._registry))):
            self.absent(worker.worker, worker.stage, now, session=worker.card.session, why="not heard of")
        self._give_up(now)
        self._rates.tick(now)

    def _give_up(self, now: float) -> None:
        for entry in self._patience.lost(now):
            if isinstance(entry, Noted) or self._core.tasks.get(entry.key) is not None:
                self._do(entry, now)
                self._choose(now)

    # ---- orders and overview -------------------------------------------------------------------------------------

    def control(self, control: Control, now: float) -> Answer:
        """Take an operator's order or answer a question."""
        if control.verb == "status":
            return Answer(accepted=True, status=self.status(now))
        if control.verb == "events":
            events = self._read_model.events(max(1, control.number))
            return Answer(accepted=True, status=self.status(now), events=events)
        objection = self._dispatch.objection(control, self._reducer.scorers.model)
        if objection:
            return Answer(accepted=False, message=objection, status=self.status(now))
        if not self._reducer.scorers.is_under_way(control):
            before = self._core.rounds.budget
            self._do(Ordered(control=control), now)
            if (budget := self._core.rounds.budget) != before:  # noted beside it: older journals tell what they told
                self._do(Noted(fact=BudgetChanged(budget=budget, previous=before)), now)
        self._stop_clocks()
        self._choose(now)
        return Answer(accepted=True, status=self.status(now))

    def status(self, now: float) -> Status:
        """Return the campaign at a glance."""
        return status_of(self._reducer, self._registry, self._leases, self._rates, now)

    def validate(self) -> None:
        """Assert every invariant of the books; for tests and audits."""
        validate(self._core, self._leases)
        self._reducer.minimization.validate()
