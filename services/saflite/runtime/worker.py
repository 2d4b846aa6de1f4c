"""The one loop of all pools, as a pure state machine: events in, instructions out. The shell is `worker_shell.py`.

    join -> ask (long poll) -> begin -> work done -> keep on disk -> report until a receipt comes -> forget
    beat in between: names the leases held; orders to cancel or stop come back with the answer

Books that were restarted know nobody: the worker joins again and goes on with what it holds. It never waits and never
reads a clock: `handle(event, now_s)` answers with what to do, `next_s` says when it wants to be woken at the latest.
"""

from __future__ import annotations

from msgspec.structs import replace

from saflite.contract.join import Joined
from saflite.contract.rng import derive_seed
from saflite.contract.work import (
    BEATS_PER_LEASE,
    Ask,
    Failure,
    FlyResult,
    Grant,
    HandedBack,
    Heartbeat,
    Lease,
    Orders,
    Report,
    Result,
)
from saflite.runtime.joining import Joining
from saflite.runtime.pending import Pending
from saflite.runtime.worker_events import (
    Answered,
    Begin,
    Cancel,
    Done,
    DrainAsked,
    Event,
    Forget,
    Found,
    Granted,
    Instruction,
    Keep,
    Key,
    Leave,
    LeftFor,
    Ordered,
    Received,
    Renew,
    SendAsk,
    SendBeat,
    SendJoin,
    SendReport,
    StopAsked,
    Tick,
    WorkerConfig,
)

__all__ = [
    "Answered",
    "Begin",
    "Cancel",
    "Done",
    "DrainAsked",
    "Event",
    "Forget",
    "Found",
    "Granted",
    "Instruction",
    "Keep",
    "Key",
    "Leave",
    "LeftFor",
    "Ordered",
    "Received",
    "Renew",
    "SendAsk",
    "SendBeat",
    "SendJoin",
    "SendReport",
    "StopAsked",
    "Tick",
    "Worker",
    "WorkerConfig",
]

JOIN_TIMEOUT_S = 5.0
CALM_S = 3.0  # between heartbeats, until the books have said how often they want them
DEAF_FIRST_S, DEAF_MAX_S = 20.0, 320.0  # unanswered for so long, or up to twice, it connects anew; then less often
BEATS_MISSED = 4  # so many unanswered are silence, however seldom they are
STOOD_STILL_S = 5.0  # its shell ticks each second
ASK_MARGIN_S = 5.0  # how much longer than the long poll an answer may take
RETRY_FIRST_S, RETRY_MAX_S = 0.1, 2.0
REPORTS_WAITING_MAX, GRANTS_MAX = 16, 18  # undelivered: then no work is taken; answers thought lost come after all
STOP_GRACE_S = 5.0
STUCK_S = 120.0  # a model server's answer may take that long; what had all the time of its lease gets STOP_GRACE_S
LAST_ANSWERS_S = 2.0  # of those: what goes on though it was told to end is handed back in time for an answer
DRAINED = "needed no more, and all it held is done"


class Worker:
    """The state machine of one worker."""

    def __init__(self, config: WorkerConfig, now_s: float, cursor: int = -1) -> None:
        self.config = config
        self.cursor = cursor  # the shell keeps it at what the service has been told
        self.parallel = config.parallel  # may grow while running
        self.stopping, self.draining = "", False
        self._left_for: LeftFor = "done"
        self._joining = Joining(now_s)
        self._heard_s = self._renewed_s = now_s
        self._share = 1.0 + derive_seed(0, config.worker) / 2**63  # so that hundreds do not come at once
        self._deaf_s = DEAF_FIRST_S
        self._waiting: list[Lease] = []
        self._running: dict[Key, Lease] = {}
        self._overdue_s: dict[Key, float] = {}  # of those that run: when all their time is over
        self._cancelled: dict[Key, float] = {}  # and since when (s)
        self._pending: dict[Key, Pending] = {}
        self._asking = self._beating = self._left = False
        self._ask_s, self._beat_s, self._leave_s = now_s, now_s, float("inf")
        self._calm_s = CALM_S
        self._ask_wait_s, self._seen_s, self._busy_s, self._idle_s = RETRY_FIRST_S, now_s, 0.0, 0.0
        self._done, self._simulated_s, self._resident_mib, self._processor_s = 0, 0.0, 0.0, 0.0

    # -- in -------------------------------------------------------------------------------------------------------

    def handle(self, event: Event, now_s: float) -> list[Instruction]:
        """Take one event and return what to do, in order."""
        self._account(now_s)
        out: list[Instruction] = []
        if isinstance(event, Answered):
            self._on_joined(event.joined, now_s, out)
        elif isinstance(event, Granted):
            self._on_grant(event.grant, now_s, out)
        elif isinstance(event, Ordered):
            self._on_orders(event.orders, now_s, out)
        elif isinstance(event, Received):
            self._on_receipt(event, now_s, out)
        elif isinstance(event, Done):
            self._on_done(event, now_s, out)
        elif isinstance(event, Found):
            found = event.report
            self._pending[Key(found.lease_id, found.epoch)] = Pending(found, now_s)
        elif isinstance(event, StopAsked):
            self._stop(event.why, now_s, out)
        elif isinstance(event, DrainAsked):
            self.draining, self._beat_s = True, now_s
        else:
            self._resident_mib = event.resident_mib or self._resident_mib
            self._processor_s = event.processor_s or self._processor_s
        self._proceed(now_s, out)
        return out

    def next_s(self) -> float:
        """Return when a `Tick` is wanted at the latest."""
        own_s = (self._abandon_s(), self._stuck_s(), self._impatient_s(), self._renew_s())
        times = [self._leave_s, self._joining.next_s(), *own_s]
        if self.is_in and not self._asking and self._wanted() > 0:
            times.append(self._ask_s)
        if self.is_in and not self._beating:
            times.append(self._beat_s)
        times += [pending.next_s for pending in self._pending.values() if not pending.sending]
        return min(times)

    def validate(self) -> None:
        """Raise AssertionError if the state contradicts itself."""
        assert len(self._running) <= self.parallel, "more work begun than slots"
        assert not (self._running.keys() & self._pending.keys()), "reported while running"
        assert self._cancelled.keys() <= self._running.keys(), "cancelled what does not run"
        assert not (self.stopping and self._waiting), "leases held back while stopping"

    @property
    def is_in(self) -> bool:
        """Whether the books have let this worker in."""
        return bool(self._joining.session)

    @property
    def held(self) -> tuple[Key, ...]:
        """The leases this worker holds: waiting, running, and done but not acknowledged."""
        waiting = [Key(lease.lease_id, lease.epoch) for lease in self._waiting]
        running = [key for key in self._running if key not in self._cancelled or self.stopping]
        return (*waiting, *running, *self._pending)

    # -- events ---------------------------------------------------------------------------------------------------

    def _on_joined(self, joined: Joined | None, now_s: float, out: list[Instruction]) -> None:
        self._joining.answered(joined, now_s)
        self._heard_s = self._heard_s if joined is None else now_s
        if joined is not None and joined.accepted:
            self._ask_s = self._beat_s = now_s
        if self._joining.refused:
            self._stop(self._joining.refused, now_s, out, "refused")

    def _on_grant(self, grant: Grant | None, now_s: float, out: list[Instruction]) -> None:
        self._asking = False
        if grant is None:
            self._ask_s = now_s + self._ask_wait_s
            self._ask_wait_s = min(2 * self._ask_wait_s, RETRY_MAX_S)
            return
        self._heard_s, self._ask_wait_s = now_s, RETRY_FIRST_S
        self._ask_s = now_s if grant.leases else now_s + grant.retry_after_s
        self._take(grant, now_s, out)

    def _take(self, grant: Grant, now_s: float, out: list[Instruction]) -> None:
        if grant.refused:
            self._joining.lost(now_s)
        held = set(self.held)
        granted = {Key(lease.lease_id, lease.epoch): lease for lease in grant.leases}
        self._waiting += (lease for key, lease in granted.items() if key not in held)
        del self._waiting[GRANTS_MAX * (self.parallel + self.config.prefetch) :]
        if grant.stop:
            self._stop("the campaign is over", now_s, out)
        elif self.stopping:
            self._hand_back(now_s, out)
        if grant.leases:
            self._beat_s = min(self._beat_s, now_s + self._beat_period_s())

    def _on_orders(self, orders: Orders | None, now_s: float, out: list[Instruction]) -> None:
        self._beating = False
        if orders is None:
            return
        self._heard_s, self._calm_s = now_s, orders.beat_s or CALM_S
        if orders.refused:
            self._joining.lost(now_s)
        for lease_id in orders.cancel:
            self._waiting = [lease for lease in self._waiting if lease.lease_id != lease_id]
            for key in [key for key in self._running if key.lease_id == lease_id and key not in self._cancelled]:
                self._cancelled[key] = now_s
                out.append(Cancel(key))
        if orders.stop:
            self._stop("the books said stop", now_s, out)

    def _on_receipt(self, event: Received, now_s: float, out: list[Instruction]) -> None:
        self._heard_s = self._heard_s if event.receipt is None else now_s
        pending = self._pending.get(event.key)
        if pending is None:
            return
        asked, pending.asks = pending.asks, False
        if event.receipt is not None or pending.is_given_up(now_s, refused=event.refused):
            del self._pending[event.key]
            out.append(Forget(event.key))
        grant = None if event.receipt is None else event.receipt.grant
        if asked:
            self._on_grant(grant, now_s, out)
        elif grant is not None:  # the result was sent again, but answered as it was sent first
            self._take(grant, now_s, out)

    def _on_done(self, event: Done, now_s: float, out: list[Instruction]) -> None:
        self._overdue_s.pop(event.key, None)
        if self._running.pop(event.key, None) is None:
            return  # it was handed back while it went on
        dropped = self._cancelled.pop(event.key, None) is not None
        result = event.result
        if dropped and not self.stopping:
            return
        if dropped and isinstance(result, Failure):
            result = HandedBack(message=self.stopping)
        else:
            self._done += 1
        if isinstance(result, FlyResult):
            self._simulated_s += result.flight.simulated_s
        self._report(event.key, result, now_s, out)

    def _stop(self, why: str, now_s: float, out: list[Instruction], left_for: LeftFor = "done") -> None:
        if self.stopping:
            return
        self.stopping, self._left_for = why, left_for
        self._leave_s = now_s + STOP_GRACE_S
        self._hand_back(now_s, out)
        for key in self._running:
            if key not in self._cancelled:
                self._cancelled[key] = now_s
                out.append(Cancel(key))

    def _hand_back(self, now_s: float, out: list[Instruction]) -> None:
        for lease in self._waiting:
            self._report(Key(lease.lease_id, lease.epoch), HandedBack(message=self.stopping), now_s, out)
        self._waiting = []

    def _report(self, key: Key, result: Result, now_s: float, out: list[Instruction]) -> None:
        report = Report(worker=self.config.worker, lease_id=key.lease_id, epoch=key.epoch, result=result)
        self._pending[key] = Pending(report, now_s)
        if not isinstance(result, HandedBack):
            out.append(Keep(report))

    # -- out ------------------------------------------------------------------------------------------------------

    def _proceed(self, now_s: float, out: list[Instruction]) -> None:
        """Do whatever is due: reports, work, questions, heartbeats, leaving."""
        if now_s >= self._abandon_s():
            self._waiting += self._running.values()
            self._running, self._cancelled = {}, {}
            self._hand_back(now_s, out)
        while self._waiting and len(self._running) < self.parallel:
            lease = self._waiting.pop(0)
            key = Key(lease.lease_id, lease.epoch)
            self._running[key], self._overdue_s[key] = lease, now_s + (lease.overdue_s or float("inf"))
            out.append(Begin(lease))
        for pending in self._pending.values():
            if not pending.sending and pending.next_s <= now_s:
                report = self._as_sent(pending, now_s)
                pending.sending = True
                out.append(SendReport(report, pending.timeout_s))
        if now_s >= self._impatient_s():
            self._stop(f"nobody has answered for {now_s - self._heard_s:.0f} s", now_s, out, "unanswered")
        if now_s >= self._stuck_s():
            self._stop("its work goes on long after it was taken back", now_s, out, "stuck")
        if now_s >= self._renew_s():
            self._renewed_s, self._deaf_s = now_s, min(2 * self._deaf_s, DEAF_MAX_S)
            out.append(Renew())
        if self._joining.due(now_s):
            out.append(SendJoin(JOIN_TIMEOUT_S))
        if self._asks_now(now_s):
            self._asking = True
            out.append(SendAsk(self._ask(), self.config.poll_s + ASK_MARGIN_S))
        if self.is_in and not self._beating and self._beat_s <= now_s:
            self._beating = True
            period_s = self._beat_period_s()
            self._beat_s = now_s + period_s
            out.append(SendBeat(self._beat(), period_s))
        hopeless = self._left_for in ("refused", "unanswered") and not self._running  # results stay in the spool
        done = self.stopping and not self._running and (hopeless or not self._pending)
        drained = self.draining and not self._asking and not self.held  # a poll under way may still bring work
        if not self._left and (done or drained or now_s >= self._leave_s):
            self._left = True
            out.append(Leave(self.stopping or DRAINED, self._left_for))

    def _abandon_s(self) -> float:
        answered = self._running and self._left_for in ("done", "stuck")
        return self._leave_s - LAST_ANSWERS_S if answered else float("inf")

    def _stuck_s(self) -> float:
        """Return when it gives up on work that heeds no cancelling: its thread cannot be ended, its process can."""
        cancelled = () if self.stopping else self._cancelled.items()
        until_s = (min(at_s + STUCK_S, max(at_s, self._overdue_s[key]) + STOP_GRACE_S) for key, at_s in cancelled)
        return min(until_s, default=float("inf"))

    def _impatient_s(self) -> float:
        patient = not self.config.patience_s or self.stopping
        return float("inf") if patient else self._heard_s + self.config.patience_s

    def _renew_s(self) -> float:
        if self._heard_s > self._renewed_s:
            self._deaf_s = DEAF_FIRST_S
        return max(self._heard_s, self._renewed_s) + self._share * max(self._deaf_s, BEATS_MISSED * self._calm_s)

    def _wanted(self) -> int:
        if self.stopping or self.draining or len(self._pending) > REPORTS_WAITING_MAX:
            return 0
        free = self.parallel - len(self._running) - len(self._waiting)
        return free if free > 0 else self.config.prefetch - len(self._waiting)

    def _asks_now(self, now_s: float) -> bool:
        return self.is_in and not self._asking and self._ask_s <= now_s and self._wanted() > 0

    def _as_sent(self, pending: Pending, now_s: float) -> Report:
        """Return a result with the next question for work, if one is due; sent again it goes alone, for it may hang."""
        if pending.was_sent or not self._asks_now(now_s):
            return pending.report
        self._asking = pending.asks = True
        return replace(pending.report, ask=self._ask())

    def _ask(self) -> Ask:
        config = self.config
        return Ask(
            worker=config.worker,
            stage=config.stage,
            session=self._joining.session,
            leases_max=self._wanted(),
            wait_s=config.poll_s,
            cursor=self.cursor,
            targets=config.targets,
        )

    def _beat(self) -> Heartbeat:
        return Heartbeat(
            worker=self.config.worker,
            stage=self.config.stage,
            session=self._joining.session,
            leases=self.held,
            state="draining" if self.stopping or self.draining else "busy" if self._running else "idle",
            busy_s=round(self._busy_s, 3),
            idle_s=round(self._idle_s, 3),
            done=self._done,
            simulated_s=round(self._simulated_s, 3),
            resident_mib=self._resident_mib,
            processor_s=self._processor_s,
        )

    def _beat_period_s(self) -> float:
        leases = [*self._waiting, *self._running.values()]
        return min([self._calm_s, *(lease.lease_s / BEATS_PER_LEASE for lease in leases)])

    def _account(self, now_s: float) -> None:
        passed_s, self._seen_s = now_s - self._seen_s, now_s
        if passed_s > STOOD_STILL_S:  # answers may lie ready: it has not listened
            self._renewed_s = now_s
        if self._running:
            self._busy_s += passed_s
        else:
            self._idle_s += passed_s
