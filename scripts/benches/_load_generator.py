"""A load generator: simulated workers in one thread over real Zenoh: real worker loops and messages, made-up work.

What is made up is only the doing: a flight takes `think_s` of waiting and leaves a small trace, a share of the
verdicts is a violation. The books, the store and the bus are the real ones.
"""

from __future__ import annotations

import heapq
import queue
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from saflite.bus.base import Bus, Reply
from saflite.contract import topics, wire
from saflite.contract.blobs import Blobs
from saflite.contract.flight import Flight, Trace, pack_trace, trace_digest
from saflite.contract.join import Join, Joined
from saflite.contract.rng import derive
from saflite.contract.score import Score
from saflite.contract.test_case import TestCase, identity
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import (
    FlyResult,
    FlyWork,
    Grant,
    JudgeResult,
    JudgeWork,
    MutateResult,
    MutateWork,
    Orders,
    Receipt,
    RecordResult,
    RecordWork,
    Result,
    ScoreResult,
    ScoreWork,
    Stage,
    TargetBuild,
    WarmResult,
    Work,
)
from saflite.runtime import worker as machine
from saflite.runtime.clock import WallClock
from saflite.runtime.software import card_of
from saflite.runtime.worker import Key, Worker, WorkerConfig

Doing = Callable[[Work, str], Result]


REFERENCE = (TargetBuild("reference"),)


class Made(NamedTuple):
    """Made-up work: how large traces are and what share of the flights violates, and where blobs of a worker go."""

    blobs: Callable[[str], Blobs]
    trace_samples: int = 200
    violation_share: float = 0.02

    def do(self, work: Work, worker: str) -> Result:
        """Return a valid result for any work; a pure function of the work, except for the worker's name."""
        if isinstance(work, MutateWork):
            return MutateResult(round=work.round, test_cases=tuple(_mutant(work, index) for index in range(work.count)))
        if isinstance(work, ScoreWork):
            names = [identity(case) for case in work.test_cases]
            values = [float(derive(1, "score", name).random() * 10) for name in names]
            pairs = zip(names, values, strict=True)
            scores = [
                Score(test_case=name, value=value, model=work.model, scored_by=work.model) for name, value in pairs
            ]
            return ScoreResult(scores=tuple(scores))
        if isinstance(work, FlyWork):
            return self._fly(work, worker)
        if isinstance(work, JudgeWork):
            return self._judge(work)
        if isinstance(work, RecordWork):
            name, index = work.flight.test_case, work.flight.flight_index
            return RecordResult(test_case=name, flight_index=index, blob=self.blobs(worker).put(name.encode()))
        return WarmResult(model=work.model, ready=True)

    def _fly(self, work: FlyWork, worker: str) -> FlyResult:
        name = identity(work.test_case)
        signal = derive(1, "trace", name).random(self.trace_samples).astype("<f4")
        trace = Trace(step_s=0.1, signals={"altitude_m": signal.tobytes()})
        flight = Flight(
            test_case=name,
            flight_index=work.flight_index,
            ending="completed",
            simulated_s=trace.duration_s,
            wall_s=0.1,
            trace_digest=trace_digest(trace),
            trace=self.blobs(worker).put(pack_trace(trace)),
            worker=worker,
        )
        return FlyResult(flight=flight)

    def _judge(self, work: JudgeWork) -> JudgeResult:
        name = work.flight.test_case
        violated = float(derive(1, "verdict", name).random()) < self.violation_share
        verdict = Verdict(
            policy=work.policies[0],
            outcome="violated" if violated else "held",
            robustness=-0.5 if violated else 0.5,
            severity="soft" if violated else "none",
        )
        return JudgeResult(
            judgement=Judgement(
                test_case=name,
                flight_index=work.flight.flight_index,
                verdicts=(verdict,),
                fingerprint=name if violated else "",
            )
        )


def _mutant(work: MutateWork, index: int) -> TestCase:
    import msgspec

    number = work.round * 1_000_000 + index
    origin = msgspec.structs.replace(work.template.origin, strategy=work.strategy, round=work.round, index=index)
    return msgspec.structs.replace(work.template, rng_seed=number, origin=origin)


class LoadGenerator:
    """Many workers on few sessions. Call `run_for` to let them work."""

    def __init__(self, buses: Sequence[Bus], campaign: str, made: Made, think_s: float) -> None:
        self._buses, self._campaign, self._made, self._think_s = buses, campaign, made, think_s
        self._clock = WallClock()
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._workers: list[Worker] = []
        self._cards: list[Join] = []
        self._timers: list[tuple[float, int, int, Any]] = []
        self._tick_s: dict[int, float] = {}
        self._count = 0
        self._asked_s: dict[int, float] = {}
        self.grant_s: list[
            float
        ] = []  # ask (with or without a report) to grant, of flyers: work lies ready for them (judges wait for flights)
        self.receipt_s: list[float] = []  # report to receipt
        self._reported_s: dict[tuple[int, Key], float] = {}
        self.reports = self.grants = 0
        self.stopped = False
        self.reported_at_s: dict[str, list[float]] = {}  # test case: when its fly and judge results went out

    def join(
        self, stage: Stage, count: int, *, targets: tuple[TargetBuild, ...] = REFERENCE, poll_s: float = 5.0
    ) -> None:
        """Add workers of one stage."""
        for _ in range(count):
            index = len(self._workers)
            config = WorkerConfig(f"{stage}-{index}", stage, 1, 0, poll_s, targets if stage == "fly" else ())
            self._workers.append(Worker(config, self._clock.monotonic_s()))
            card = card_of(stage, config.worker, self._clock, targets=config.targets)
            self._cards.append(card)
            bus = self._buses[index % len(self._buses)]
            bus.appear(topics.alive(self._campaign, stage, config.worker, card.session))
            self._feed(index, machine.Tick())

    def run_for(self, duration_s: float) -> None:
        """Let the generator work for a while."""
        until_s = self._clock.monotonic_s() + duration_s
        while (now_s := self._clock.monotonic_s()) < until_s and not self.stopped:
            while self._timers and self._timers[0][0] <= now_s:
                at_s, _, index, event = heapq.heappop(self._timers)
                if event is not None:
                    self._feed(index, event)
                elif at_s == self._tick_s.get(index):  # otherwise an earlier tick took its place
                    del self._tick_s[index]
                    self._feed(index, machine.Tick())
            wait_s = min(until_s, self._timers[0][0] if self._timers else until_s) - self._clock.monotonic_s()
            try:
                reply = self._inbox.get(timeout=max(0.0, min(wait_s, 0.2)))
            except queue.Empty:
                continue
            self._take(reply)

    def _take(self, reply: Reply) -> None:
        assert isinstance(reply.tag, tuple)
        index, what = reply.tag
        now_s = self._clock.monotonic_s()
        if what == "join":
            joined = None if reply.payload is None else wire.decode(reply.payload, Joined)
            assert joined is None or joined.accepted, joined
            self._feed(index, machine.Answered(joined))
        elif what == "ask":
            grant = None if reply.payload is None else wire.decode(reply.payload, Grant)
            self._count_grant(index, grant, now_s)
            self._feed(index, machine.Granted(grant))
        elif what == "beat":
            self._feed(index, machine.Ordered(None if reply.payload is None else wire.decode(reply.payload, Orders)))
        else:
            receipt = None if reply.payload is None else wire.decode(reply.payload, Receipt)
            if receipt is not None:
                self.receipt_s.append(now_s - self._reported_s.pop((index, what)))
                self.reports += receipt.status == "accepted"
                self._count_grant(index, receipt.grant, now_s)
            self._feed(index, machine.Received(what, receipt, refused=bool(reply.refused)))

    def _count_grant(self, index: int, grant: Grant | None, now_s: float) -> None:
        if grant is not None and grant.leases:
            if self._workers[index].config.stage == "fly":
                self.grant_s.append(now_s - self._asked_s[index])
            self.grants += len(grant.leases)
        if grant is not None and grant.stop:
            self.stopped = True

    def _feed(self, index: int, event: machine.Event) -> None:
        worker = self._workers[index]
        now_s = self._clock.monotonic_s()
        for instruction in worker.handle(event, now_s):
            self._obey(index, worker, instruction, now_s)
        next_s = max(worker.next_s(), now_s + 0.001)
        if next_s < self._tick_s.get(index, float("inf")):
            self._tick_s[index] = next_s
            self._timer(next_s, index, None)

    def _obey(self, index: int, worker: Worker, instruction: machine.Instruction, now_s: float) -> None:
        bus, stage = self._buses[index % len(self._buses)], worker.config.stage
        if isinstance(instruction, machine.SendJoin):
            card = wire.encode(self._cards[index])
            bus.ask(topics.join(self._campaign, stage), card, (index, "join"), self._inbox.put, instruction.timeout_s)
        elif isinstance(instruction, machine.SendAsk):
            self._asked_s[index] = now_s
            ask = wire.encode(instruction.ask)
            bus.ask(topics.work(self._campaign, stage), ask, (index, "ask"), self._inbox.put, instruction.timeout_s)
        elif isinstance(instruction, machine.SendBeat):
            beat = wire.encode(instruction.beat)
            bus.ask(topics.beat(self._campaign, stage), beat, (index, "beat"), self._inbox.put, instruction.timeout_s)
        elif isinstance(instruction, machine.SendReport):
            report = instruction.report
            key = Key(report.lease_id, report.epoch)
            self._reported_s[index, key] = now_s
            if report.ask is not None:
                self._asked_s[index] = now_s
            if isinstance(report.result, FlyResult):
                self.reported_at_s.setdefault(report.result.flight.test_case, []).append(now_s)
            elif isinstance(report.result, JudgeResult):
                self.reported_at_s.setdefault(report.result.judgement.test_case, []).append(now_s)
            data = wire.encode(report)
            bus.ask(topics.result(self._campaign, stage), data, (index, key), self._inbox.put, instruction.timeout_s)
        elif isinstance(instruction, machine.Begin):
            lease = instruction.lease
            result = self._made.do(lease.work, worker.config.worker)
            if isinstance(lease.work, MutateWork | ScoreWork):
                worker.cursor = lease.work.cursor  # as real ones: nobody is told twice
            wait_s = self._think_s if stage == "fly" else 0.0
            self._timer(now_s + wait_s, index, machine.Done(Key(lease.lease_id, lease.epoch), result))

    def _timer(self, at_s: float, index: int, event: machine.Event | None) -> None:
        self._count += 1
        heapq.heappush(self._timers, (at_s, self._count, index, event))


def percentile_ms(values: Sequence[float], share: float) -> float:
    """Return a percentile of times in milliseconds, NaN if there are none."""
    return round(float(np.percentile(values, share)) * 1000, 2) if values else float("nan")
