"""The members of the simulated farm: the books with their shell, and workers, each of which can die and freeze.

Both run the real thing: `BooksService` around the real books, and the real state machine of the worker loop.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Literal, Protocol, TypeVar

import msgspec
import numpy as np
from farm_blobs import FarmBlobs, FarmWorkerBlobs
from farm_doubles import TEMPLATE, Service, babble, is_poison, luck
from farm_store import Crash, MemoryStore

from saflite.bus.base import Happening, Reply
from saflite.bus.memory import MemoryNetwork
from saflite.campaign.engine.state import Books
from saflite.contract import topics, wire
from saflite.contract.blobs import BlobMissing
from saflite.contract.flight import Ending, Flight
from saflite.contract.join import Join, Joined
from saflite.contract.test_case import identity
from saflite.contract.work import (
    Failure,
    FlyResult,
    FlyWork,
    Grant,
    Lease,
    MutateResult,
    MutateWork,
    Orders,
    Receipt,
    Report,
    Result,
    ScoreWork,
    Stage,
    TargetBuild,
    Work,
    blobs_left,
)
from saflite.runtime import worker as machine
from saflite.runtime.books_service import BooksService
from saflite.runtime.software import software_of
from saflite.runtime.worker import Key, Worker, WorkerConfig

T = TypeVar("T")

StrategyEnds = Literal["", "raises", "takes its process down", "proposes nothing"]
"""What becomes of a strategy before the budget is spent; empty: nothing does."""

ENDS_FROM = 3
"""The round from which on it does so."""


class Watcher(Protocol):
    """Hears what workers were told, to check it against the books afterwards."""

    def sent(self, report: Report) -> None:
        """A worker sends a result."""
        ...

    def received(self, report: Report, receipt: Receipt) -> None:
        """A worker got a receipt."""
        ...


class ShiftedClock:
    """The network's time, begun anew with each process of the books."""

    def __init__(self, network: MemoryNetwork, shift_s: float) -> None:
        self._network, self._shift_s = network, shift_s

    def monotonic_s(self) -> float:
        """See `Clock.monotonic_s`."""
        return self._network.now_s + self._shift_s

    def unix_s(self) -> float:
        """See `Clock.unix_s`."""
        return 1.7e9 + self._network.now_s


class BooksMember:
    """The process of the books."""

    def __init__(self, network: MemoryNetwork, store: MemoryStore, rng: np.random.Generator) -> None:
        self._network, self.store, self._rng = network, store, rng
        self.books: Books | None = None
        self.service: BooksService | None = None
        self.restarts = 0
        self.frozen = False
        self.must_tick = True

    def start(self) -> None:
        """Open the books and serve them."""
        clock = ShiftedClock(self._network, float(self._rng.integers(0, 10**6)))
        self.books = self.store.rebuild()
        self.books.begin(clock.monotonic_s(), clock.unix_s())
        bus = self._network.connect("books")
        self.service = BooksService(bus, self.store.campaign.name, self.books, self.store, clock)  # type: ignore[arg-type]
        self.service.open()
        self.must_tick = True
        self.step()

    def die(self) -> None:
        """As kill -9 does."""
        self._network.crash("books")
        self.books = self.service = None
        self.store.crash_next = ""
        self.restarts += 1
        self._network.later(float(self._rng.random() * 3.0), self.start)

    def step(self) -> None:
        """Handle what has come in."""
        if self.service is None or self.books is None or self.frozen:
            return
        if self.service._inbox.is_empty and not self.must_tick:
            return  # nothing can have changed
        self.must_tick = False
        try:
            self.service.step(0.0)
        except Crash:
            self.die()
            return
        self.books.validate()


class WorkerMember:
    """The process of a worker. Its spool survives it; its memory does not."""

    def __init__(
        self,
        network: MemoryNetwork,
        campaign: str,
        config: WorkerConfig,
        watcher: Watcher,
        rng: np.random.Generator,
        blobs: FarmBlobs,
    ) -> None:
        self._blobs = blobs
        self._network, self._campaign, self.config, self._watcher, self._rng = network, campaign, config, watcher, rng
        self._spool: dict[Key, Report] = {}
        self._life = 0
        self.alive = False
        self.stays_away = False
        self.frozen_until_s = 0.0
        self._late: list[Happening] = []
        self.babbles = self.wedges = self.breaks = 0.0  # chances
        self.strategy_ends: StrategyEnds = ""
        self.build, self.tells_build = "", True
        self._wake_s = float("inf")

    @property
    def name(self) -> str:
        """The worker's name."""
        return self.config.worker

    # ---- life and death ------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin a new life, with what the spool holds."""
        if self.alive or self.stays_away:
            return
        self._life += 1
        self.alive, self._wake_s = True, float("inf")
        self._bus = self._network.connect(self.name)
        kept = [blob.digest for report in self._spool.values() for blob in blobs_left(report.result)]
        self._blobs.forget_but(self.name, kept)
        self._service = Service(FarmWorkerBlobs(self._blobs, self.name))
        self._machine = Worker(self.config, self._network.now_s)
        here = (TargetBuild(TEMPLATE.target.name, self.build),)
        targets = here if self.config.stage == "fly" and self.tells_build else ()
        self._card = Join(
            protocol=topics.PROTOCOL,
            worker=self.name,
            session=f"life-{self._life}",
            stage=self.config.stage,
            software=software_of(self.config.stage),
            targets=targets,
        )
        self._asked: dict[Key, Report] = {}
        for report in self._spool.values():
            self._feed(machine.Found(report))
        self._bus.appear(topics.alive(self._campaign, self.config.stage, self.name, self._card.session))
        self._feed(machine.Tick())

    def die(self) -> None:
        """As kill -9 does."""
        if self.alive:
            self.alive = False
            self._network.crash(self.name)
            self._late = []
            self._network.later(0.2 + float(self._rng.random()) * 2.0, self.start)

    def freeze(self, for_s: float) -> None:
        """As SIGSTOP does: nothing is handled, no timer runs, the token stays."""
        self.frozen_until_s = self._network.now_s + for_s
        self._network.later(for_s, self._thaw)

    def stop(self) -> None:
        """As SIGTERM does; it comes back later."""
        if self.alive:
            self._feed(machine.StopAsked("told to"))

    @property
    def _frozen(self) -> bool:
        return self._network.now_s < self.frozen_until_s

    def _thaw(self) -> None:
        late, self._late = self._late, []
        for happening in late:
            self._take(happening)
        if self.alive:
            self._feed(machine.Tick())

    # ---- in ------------------------------------------------------------------------------------------------------

    def _take(self, happening: Happening) -> None:
        if not self.alive or not isinstance(happening, Reply):
            return
        if self._frozen:
            self._late.append(happening)
            return
        tag = happening.tag
        if tag == "join":
            self._feed(machine.Answered(self._decoded(happening, Joined)))
        elif tag == "ask":
            self._feed(machine.Granted(self._decoded(happening, Grant)))
        elif tag == "beat":
            self._feed(machine.Ordered(self._decoded(happening, Orders)))
        elif isinstance(tag, Key):
            receipt = self._decoded(happening, Receipt)
            if receipt is not None and tag in self._asked:
                self._watcher.received(self._asked[tag], receipt)
            self._feed(machine.Received(tag, receipt, refused=bool(happening.refused)))

    @staticmethod
    def _decoded(reply: Reply, kind: type[T]) -> T | None:
        return None if reply.payload is None else wire.decode(reply.payload, kind)

    def _feed(self, event: machine.Event) -> None:
        if not self.alive:
            return
        self._machine.cursor = self._service.cursor
        for instruction in self._machine.handle(event, self._network.now_s):
            if self.alive:  # what was obeyed before may have ended it
                self._obey(instruction)
        if self.alive:
            self._machine.validate()
            self._plan_wake()

    def _plan_wake(self) -> None:
        wake_s = max(self._machine.next_s(), self._network.now_s + 0.001)
        if wake_s < self._wake_s and wake_s < 1e9:
            self._wake_s = wake_s
            life = self._life
            self._network.later(wake_s - self._network.now_s, lambda: self._wake(life))

    def _wake(self, life: int) -> None:
        if life != self._life or not self.alive:
            return
        self._wake_s = float("inf")
        if not self._frozen:
            self._feed(machine.Tick())

    # ---- out -----------------------------------------------------------------------------------------------------

    def _obey(self, instruction: machine.Instruction) -> None:
        stage = self.config.stage
        match instruction:
            case machine.SendJoin():
                self._send(topics.join(self._campaign, stage), self._card, "join", instruction.timeout_s)
            case machine.SendAsk():
                self._send(topics.work(self._campaign, stage), instruction.ask, "ask", instruction.timeout_s)
            case machine.SendBeat():
                self._send(topics.beat(self._campaign, stage), instruction.beat, "beat", instruction.timeout_s)
            case machine.SendReport():
                key = Key(instruction.report.lease_id, instruction.report.epoch)
                self._asked[key] = instruction.report
                self._watcher.sent(instruction.report)
                self._send(topics.result(self._campaign, stage), instruction.report, key, instruction.timeout_s)
            case machine.Begin():
                self._begin(instruction.lease)
            case machine.Keep():
                self._spool[Key(instruction.report.lease_id, instruction.report.epoch)] = instruction.report
            case machine.Forget():
                self._spool.pop(instruction.key, None)
            case machine.Leave():
                self.die()
            case machine.Cancel():
                pass  # the work runs on; the machine drops its result

    def _send(self, key: str, message: object, tag: Hashable, timeout_s: float) -> None:
        self._bus.ask(key, wire.encode(message), tag, self._take, timeout_s)  # type: ignore[arg-type]

    def _begin(self, lease: Lease) -> None:
        work, life = lease.work, self._life
        key = Key(lease.lease_id, lease.epoch)
        takes_s = (0.05 if self.config.stage in ("judge", "record") else 0.3) + float(self._rng.random())
        takes_down = self._ends(work) and self.strategy_ends == "takes its process down"
        if takes_down or (isinstance(work, FlyWork) and is_poison(identity(work.test_case))):
            self._network.later(takes_s, lambda: self.die() if life == self._life else None)
            return
        self._network.later(takes_s, lambda: self._end(life, key, lease))

    def _end(self, life: int, key: Key, lease: Lease) -> None:
        if life != self._life or not self.alive:
            return
        if self._frozen:
            self._network.later(self.frozen_until_s - self._network.now_s + 0.01, lambda: self._end(life, key, lease))
            return
        self._feed(machine.Done(key, self._result(lease)))

    def _ends(self, work: Work) -> bool:
        """Whether a strategy that ends before the budget does so now."""
        return bool(self.strategy_ends) and isinstance(work, MutateWork) and work.round >= ENDS_FROM and work.count > 0

    def _result(self, lease: Lease) -> Result:
        work = lease.work
        if isinstance(work, MutateWork) and self._ends(work):
            dry = self.strategy_ends == "proposes nothing"
            return MutateResult(round=work.round, test_cases=()) if dry else Failure(message="no")
        chance = float(self._rng.random())
        if isinstance(work, ScoreWork) and chance < self.babbles:
            return babble(work, self._rng)
        if isinstance(work, FlyWork) and chance < self.wedges + self.breaks:
            ending: Ending = "wedged" if chance < self.wedges else "infra"
            result = self._service.do(work)
            assert isinstance(result, FlyResult)
            name = result.flight.test_case
            return FlyResult(flight=Flight(test_case=name, flight_index=work.flight_index, ending=ending))
        try:
            result = self._service.do(work)
        except BlobMissing as fault:
            return Failure(message=str(fault), unread=(fault.ref,))
        if isinstance(result, FlyResult):
            return FlyResult(flight=msgspec.structs.replace(result.flight, build=self.build))
        return result


class Crew(Protocol):
    """What the workers of a farm are like."""

    @property
    def simulators(self) -> int:
        """How many fly."""
        ...

    @property
    def builds(self) -> bool:
        """Whether they fly on different builds."""
        ...


def members(
    network: MemoryNetwork,
    campaign: str,
    crew: Crew,
    watcher: Watcher,
    rng: np.random.Generator,
    blobs: FarmBlobs,
) -> list[WorkerMember]:
    """One worker of each stage, two scorers, and those that fly.

    With `builds` the first and third fly on one build, the second on another, and the third says nothing of it.
    """
    many_of: dict[Stage, int] = {"mutate": 1, "score": 2, "fly": crew.simulators, "judge": 1, "record": 1}
    all_of_them = [
        WorkerMember(
            network,
            campaign,
            WorkerConfig(f"{stage}-{number}", stage, prefetch=1 if stage == "fly" else 0, poll_s=2.0),
            watcher,
            rng,
            blobs,
        )
        for stage, many in many_of.items()
        for number in range(many)
    ]
    for number, worker in enumerate(worker for worker in all_of_them if worker.config.stage == "fly"):
        if crew.builds:
            worker.build, worker.tells_build = ("one", "other", "one")[number % 3], number % 3 < 2
    return all_of_them


__all__ = ["BooksMember", "Watcher", "WorkerMember", "luck", "members"]
