"""The fold: each journal line changes the state in one determined way. Live and replayed lines take the same path."""

from __future__ import annotations

from saflite.campaign.engine.core import Core
from saflite.campaign.engine.journal import (
    Entry,
    GaveUp,
    Granted,
    Line,
    Noted,
    Opened,
    Ordered,
    Placed,
    Pruned,
    Returned,
    Selected,
    Settled,
    TraceMissing,
)
from saflite.campaign.lifecycle import retention
from saflite.campaign.lifecycle.behaviours import Behaviours
from saflite.campaign.lifecycle.flights import Flights
from saflite.campaign.lifecycle.minimization import Minimization
from saflite.campaign.lifecycle.proposals import Proposals
from saflite.campaign.lifecycle.repeat_checks import RepeatChecks
from saflite.campaign.lifecycle.scorer_swap import Scorers
from saflite.campaign.scheduling.tasks import Task
from saflite.campaign.scheduling.work_keys import (
    FlightKey,
    FlyKey,
    JudgeKey,
    MutateKey,
    RecordKey,
    ScoreKey,
    WarmKey,
    WorkKey,
)
from saflite.contract.control import Control
from saflite.contract.events import CampaignChanged, WorkerChanged
from saflite.contract.flight import Flight
from saflite.contract.names import recording_file
from saflite.contract.test_case import TestCase
from saflite.contract.work import (
    Failure,
    FlyResult,
    JudgeResult,
    MutateResult,
    RecordResult,
    ScoreResult,
    WarmResult,
)

UNDELIVERED_MAX = 10
"""After so many grants no heartbeat ever named, the next counts as an attempt: else such a test case never ends."""

RECORD_FAILURES_MAX = 5


class Reducer:
    """The durable part of the books."""

    def __init__(self, core: Core) -> None:
        self.core = core
        self.minimization = Minimization(core)
        self.checks = RepeatChecks(core)
        self.behaviours = Behaviours(core)
        self.flights = Flights(core, self.minimization, self.checks, self.behaviours)
        self.proposals = Proposals(core, self.flights)
        self.scorers = Scorers(core)

    def apply(self, line: Line) -> tuple[Placed, ...]:
        """Change the state by one line; returns what finds it let be recognised: what the line says, if it says so."""
        self.core.out.begin_line()
        self.behaviours.expect_placed({one.test_case: one.behaviours for one in line.placed})
        if isinstance(line.entry, Opened):
            self._change_clock(line.at_s)
        self.core.at_s = line.at_s
        self._apply(line.entry)
        self.flights.settle()
        for candidate in self.minimization.advance() if self.minimization.candidates else ():
            self.flights.fly_smallest(candidate)
        self.proposals.advance()
        return tuple(Placed(name, behaviours) for name, behaviours in self.behaviours.placed_now())

    def _apply(self, entry: Entry) -> None:
        match entry:
            case Opened():
                self._opened(entry)
            case Granted():
                task = self.core.tasks.lend(entry.key, entry.epoch, entry.worker, self.core.at_s)
                task.model, task.catching_up = entry.model or task.model, entry.catching_up
            case Returned():
                self._returned(entry)
            case Settled():
                self._settled(entry)
            case Selected():
                self.proposals.on_selected(entry)
            case Ordered():
                self._ordered(entry.control)
            case Noted():
                self.core.tell(entry.fact)
                if isinstance(entry.fact, WorkerChanged):
                    self.core.note_member(entry.fact, entry.key)
            case TraceMissing():
                assert isinstance(entry.key, JudgeKey), f"{entry.key} needs no trace to be judged by"
                self._lifecycle(entry.key).on_trace_missing(self._task(entry.key), entry.key, entry.message)
            case GaveUp():
                self._given_up(entry.key, entry.message)
            case Pruned():
                retention.prune(self.core, entry)

    def _task(self, key: WorkKey) -> Task:
        task = self.core.tasks.get(key)
        assert task is not None, f"{key} is not to be done"
        return task

    def _lifecycle(self, key: FlightKey) -> Flights | Minimization | RepeatChecks:
        """Return who decides on a flight."""
        if key.purpose == "check":
            return self.checks
        return self.minimization if key.purpose == "shrink" else self.flights

    def test_case_of(self, key: FlightKey) -> TestCase:
        """Return the test case that is flown or judged."""
        return self._lifecycle(key).test_case(key)

    def flight_of(self, key: JudgeKey) -> Flight:
        """Return the flight that is judged."""
        return self._lifecycle(key).flight(key)

    def lacks_its_trace(self, key: WorkKey, failure: Failure) -> bool:
        """Whether what could not be read is the trace of the very flight that was to be judged or recorded."""
        match key:
            case JudgeKey():
                return failure.unread == (self.flight_of(key).trace,)
            case RecordKey():
                return failure.unread == (self.core.records[key].flight.trace,)
        return False

    # ---- opening and orders --------------------------------------------------------------------------------------

    def _opened(self, entry: Opened) -> None:
        core = self.core
        core.out.set_wall_time(core.at_s, entry.unix_s)
        core.incarnation, core.opened_s = entry.incarnation, core.at_s
        core.out.row("sittings", entry.incarnation, entry.unix_s, core.elapsed_before_s)
        if entry.incarnation == 1:
            core.tell(CampaignChanged(state="running", why="started"))
        elif core.stopped:
            core.stopped = False
            core.change_state("running", "taken up again")

    def _change_clock(self, at_s: float) -> None:
        """Add the time so far to the campaign's time: lines from here on run on another clock."""
        core = self.core
        core.elapsed_before_s = core.elapsed_s(core.at_s)
        for task in core.tasks.leased():
            task.granted_s += at_s - core.at_s

    def _ordered(self, control: Control) -> None:
        core = self.core
        if control.verb == "pause":
            core.change_state("paused", "ordered")
        elif control.verb == "resume":
            core.stopped = False
            self.proposals.ask_again()
            core.change_state("running", "ordered")
        elif control.verb == "stop":
            core.stopped = True
            core.change_state("ended", control.text or "stopped")
        elif control.verb == "budget":
            core.rounds.budget = control.number
            if core.state == "ended" and not core.stopped and core.counts.flights < control.number:
                self.proposals.ask_again()
                core.change_state("running", f"budget raised to {control.number}")
        elif control.verb == "scorer":
            self.scorers.swap(control.text)
        elif control.verb == "shadow":
            self.scorers.watch(tuple(model for model in control.text.split(",") if model))

    # ---- leases that ended without a result ----------------------------------------------------------------------

    def _returned(self, entry: Returned) -> None:
        task, core = self._task(entry.key), self.core
        if entry.how in ("handed_back", "caught_up"):
            core.again(task, "handed_back", entry.message)
            task.losses = 0 if entry.how == "caught_up" else task.losses  # that attempt came to its end
        elif entry.how == "undelivered" and task.undelivered < UNDELIVERED_MAX:
            task.undelivered += 1
            core.again(task, "handed_back", entry.message)
        elif entry.how == "passed_on":
            core.fault(str(task.key), entry.message)
            core.again(task, "failed", entry.message)
        elif entry.how == "refused":
            self._failed(task, entry.message)
        elif entry.how == "overdue" and isinstance(task.key, ScoreKey):
            self.proposals.on_score_overdue(task, task.key, entry.message)
        else:
            self._lost(task, entry.message or entry.how)

    def _lost(self, task: Task, message: str) -> None:
        match task.key:
            case FlyKey() | JudgeKey():
                self._lifecycle(task.key).on_lost(task, task.key, message)
            case MutateKey():
                self.proposals.on_mutate_lost(task, message)
            case _:
                self._failed(task, message)

    def _failed(self, task: Task, message: str) -> None:
        match task.key:
            case FlyKey() | JudgeKey():
                self._lifecycle(task.key).on_failure(task, task.key, message)
            case MutateKey():
                self.proposals.on_mutate_failure(task, message)
            case RecordKey():
                self._record_failed(task, task.key, message)
            case WarmKey():
                self.scorers.on_failure(task, task.key, message)
            case ScoreKey():
                self.proposals.on_score_trouble(task, task.key, message)

    # ---- results -------------------------------------------------------------------------------------------------

    def _settled(self, entry: Settled) -> None:
        task = self._task(entry.key)
        if entry.epoch != task.epoch:  # a late result of an earlier attempt: whoever has the work now need not do it
            self.core.attempt_over(task, "overtaken")
            self.core.tasks.requeue(task)
        match task.key, entry.result:
            case MutateKey(), MutateResult() as result:
                self.proposals.on_mutated(task, result)
            case ScoreKey() as key, ScoreResult() as result:
                self.proposals.on_scored(task, key, result)
            case WarmKey() as key, WarmResult() as result:
                self.scorers.on_warmed(task, key, result)
            case FlyKey() as key, FlyResult() as result:
                self._lifecycle(key).on_flown(task, key, result)
            case JudgeKey() as key, JudgeResult() as result:
                self._lifecycle(key).on_judged(task, key, result)
            case RecordKey() as key, RecordResult() as result:
                self._recorded(task, key, result)
            case _, Failure() as result:
                self._failed(task, result.message)
            case _:
                raise AssertionError(f"{type(entry.result).__name__} does not settle {task.key}")

    def _recorded(self, task: Task, key: RecordKey, result: RecordResult) -> None:
        core = self.core
        trace = core.records.pop(key).flight.trace
        core.done(task, "recorded")
        file, blob = recording_file(key.test_case, key.index), result.blob
        core.hold(blob)
        if trace is not None:
            core.let_go(trace)  # the recording holds it
        if key.purpose == "shrunk" and key.test_case in core.flown:  # see `Core.stands`
            core.let_go(blob)
            return
        core.flush(blob)
        core.out.publish_blob(file, blob.digest)
        core.out.row("recordings", key.test_case, key.index, blob.digest, blob.size_bytes)

    def _record_failed(self, task: Task, key: RecordKey, message: str) -> None:
        task.failures += 1
        if task.failures >= RECORD_FAILURES_MAX:
            self._give_up_record(key, message)
        else:
            self.core.fault(str(task.key), message)
            self.core.again(task, "failed", message)

    def _given_up(self, key: WorkKey, message: str) -> None:
        match key:
            case RecordKey():
                self._give_up_record(key, message)
            case FlyKey():
                self._lifecycle(key).on_nobody(self._task(key), key, message)
            case _:
                raise AssertionError(f"{key} cannot be given up")

    def _give_up_record(self, key: RecordKey, message: str) -> None:
        del self.core.records[key]
        self.core.fault(str(key), f"no recording was written: {message}")
        self.core.done(self._task(key), "failed", message)
