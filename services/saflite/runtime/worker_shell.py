"""The shell of the worker loop: brings the state machine's instructions to the bus, the disk and the threads."""

from __future__ import annotations

import logging
import os
import queue
import threading
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import msgspec

from saflite.bus.base import Bus, Happening, Reply
from saflite.contract import topics, wire
from saflite.contract.blobs import BlobMissing
from saflite.contract.bounds import told
from saflite.contract.clock import Clock
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.join import Join, Joined
from saflite.contract.service import Service
from saflite.contract.work import Failure, Grant, Lease, Orders, Receipt, Result
from saflite.runtime import worker as machine
from saflite.runtime.log_lines import WORK_LOG, about
from saflite.runtime.spool import Spool
from saflite.runtime.worker import Key, Worker
from saflite.simulator_worker.processes import processor_s, resident_mib

log = logging.getLogger(__name__)

MEASURE_S = 1.0
MEMORY_EVERY = 10  # measures: the kernel walks all pages for it, 5 ms a worker with its simulator
T = TypeVar("T")


class _Ended(NamedTuple):
    """A piece of work has ended; `result` None means that our own code broke."""

    key: Key
    result: Result | None


class _Stop(NamedTuple):
    """A signal asked for the end."""

    why: str


class _Drain(NamedTuple):
    """The worker is needed no more once it has finished what it holds."""


class _Denied(NamedTuple):
    """The router says that this worker's key gets nothing."""

    why: str


class WorkerShell:
    """One worker process: a bus, a service, threads to do its work, and the state machine between them."""

    def __init__(
        self,
        bus: Bus,
        campaign: str,
        service: Service,
        config: machine.WorkerConfig,
        card: Join,
        spool: Spool,
        clock: Clock,
    ):
        self._card = card
        self._bus, self._campaign, self._service, self._spool, self._clock = bus, campaign, service, spool, clock
        self._machine = Worker(config, clock.monotonic_s(), service.cursor)
        self._inbox: queue.SimpleQueue[Happening | _Ended | _Stop | _Drain | _Denied] = queue.SimpleQueue()
        self._work: queue.SimpleQueue[Lease] = queue.SimpleQueue()
        self._cancelled: dict[Key, threading.Event] = {}
        self._threads = 0
        self._left: machine.Leave | None = None
        self._measured_s, self._measures = 0.0, 0
        self.denied: Callable[[], str] = str  # asked where nobody answers: why its key gets nothing, empty if it counts
        self.on_turn: Callable[[], None] = lambda: None  # called at least once in `MEASURE_S` while Python runs

    def stop(self, why: str) -> None:
        """Ask for a clean end; may be called from a signal handler or another thread."""
        self._inbox.put(_Stop(why))

    def drain(self) -> None:
        """Take no more work, and end when what is held is done; may be called like `stop`."""
        self._inbox.put(_Drain())

    def run(self) -> machine.Leave:
        """Work until told to stop; returns why it ended. Raises AssertionError when the service's own code broke."""
        config = self._machine.config
        for report in self._spool.waiting():
            self._feed(machine.Found(report))
        self._bus.appear(topics.alive(self._campaign, config.stage, config.worker, self._card.session))
        self._feed(machine.Tick())
        while self._left is None:
            self.on_turn()
            wait_s = max(0.0, min(self._machine.next_s() - self._clock.monotonic_s(), MEASURE_S))
            try:
                self._take(self._inbox.get(timeout=wait_s))
            except queue.Empty:
                self._feed(self._measure())
        return self._left

    # -- in -------------------------------------------------------------------------------------------------------

    def _take(self, happening: Happening | _Ended | _Stop | _Drain | _Denied) -> None:
        if isinstance(happening, _Ended):
            assert happening.result is not None, f"work of lease {happening.key.lease_id} broke our own code"
            self._cancelled.pop(happening.key, None)
            self._feed(machine.Done(happening.key, happening.result))
        elif isinstance(happening, _Stop):
            self._feed(machine.StopAsked(happening.why))
        elif isinstance(happening, _Drain):
            self._feed(machine.DrainAsked())
        elif isinstance(happening, _Denied):
            self._feed(machine.Answered(Joined(accepted=False, message=happening.why)))
        elif isinstance(happening, Reply):
            self._take_reply(happening)

    def _take_reply(self, reply: Reply) -> None:
        if reply.tag == "join":
            self._feed(machine.Answered(self._joined(reply)))
        elif reply.tag == "ask":
            self._feed(machine.Granted(_decoded(reply, Grant)))
        elif reply.tag == "beat":
            self._feed(machine.Ordered(_decoded(reply, Orders)))
        elif isinstance(reply.tag, Key):
            self._feed(machine.Received(reply.tag, _decoded(reply, Receipt), refused=bool(reply.refused)))

    def _joined(self, reply: Reply) -> Joined | None:
        """Return the answer to joining; one that cannot be read comes from another version, and is a refusal."""
        if reply.refused:
            return Joined(accepted=False, message=reply.refused)
        if reply.payload is None:
            return None
        try:
            joined = wire.decode(reply.payload, Joined)
        except Refused as fault:
            return Joined(accepted=False, message=f"the answer of the books is unreadable here: {fault}")
        if joined.accepted:
            log.info("joined %s as %s; it flies %s", joined.campaign, joined.worker, joined.target)
        elif joined.retry_after_s > 0.0:
            log.warning("not in yet, asked again in %.0f s: %s", joined.retry_after_s, joined.message)
        return joined

    def _feed(self, event: machine.Event) -> None:
        self._machine.cursor = self._service.cursor
        self._machine.parallel = max(self._machine.parallel, self._service.parallel)
        for instruction in self._machine.handle(event, self._clock.monotonic_s()):
            self._obey(instruction)

    # -- out ------------------------------------------------------------------------------------------------------

    def _obey(self, instruction: machine.Instruction) -> None:
        stage, campaign = self._machine.config.stage, self._campaign
        if isinstance(instruction, machine.SendJoin):
            self._send(topics.join(campaign, stage), self._card, "join", instruction.timeout_s)
        elif isinstance(instruction, machine.SendAsk):
            self._send(topics.work(campaign, stage), instruction.ask, "ask", instruction.timeout_s)
        elif isinstance(instruction, machine.SendBeat):
            self._send(topics.beat(campaign, stage), instruction.beat, "beat", instruction.timeout_s)
        elif isinstance(instruction, machine.SendReport):
            report = instruction.report
            key = Key(report.lease_id, report.epoch)
            self._send(topics.result(campaign, stage), report, key, instruction.timeout_s)
        elif isinstance(instruction, machine.Begin):
            self._begin(instruction.lease)
        elif isinstance(instruction, machine.Cancel):
            self._cancelled[instruction.key].set()
        elif isinstance(instruction, machine.Keep):
            self._keep(instruction)
        elif isinstance(instruction, machine.Forget):
            self._spool.forget(*instruction.key)
        elif isinstance(instruction, machine.Renew):
            log.warning("nobody has answered for a while: connecting anew")
            threading.Thread(target=self._renew, name="renew", daemon=True).start()
        else:
            self._left = instruction

    def _renew(self) -> None:
        """Connect anew, and take it for the answer of the books where the router says that this key gets none."""
        self._bus.renew()
        if denied := self.denied():
            self._inbox.put(_Denied(denied))

    def _send(self, key: str, message: msgspec.Struct, tag: str | Key, timeout_s: float) -> None:
        self._bus.ask(key, wire.encode(message), tag, self._inbox.put, timeout_s)

    def _begin(self, lease: Lease) -> None:
        self._cancelled[Key(lease.lease_id, lease.epoch)] = threading.Event()
        self._work.put(lease)
        if len(self._cancelled) > self._threads:  # threads stay: a child process dies with the thread that started it
            self._threads += 1
            threading.Thread(target=self._labour, name=f"work-{self._threads}", daemon=True).start()

    def _keep(self, instruction: machine.Keep) -> None:
        try:
            self._spool.keep(instruction.report)
        except Unavailable as fault:
            log.warning("result not spooled, sent all the same: %s", fault)

    # -- the working threads --------------------------------------------------------------------------------------

    def _labour(self) -> None:
        while True:
            lease = self._work.get()
            key = Key(lease.lease_id, lease.epoch)
            result: Result | None = None
            subject = about(lease.work, lease.lease_id)
            WORK_LOG.info("work begins", extra=subject)
            try:
                result = self._do(lease, self._cancelled[key].is_set)
                WORK_LOG.info("work ends: %s", type(result).__struct_config__.tag, extra=subject)
            finally:  # our own code broke: the loop must hear of it, the thread's hook prints the traceback
                self._inbox.put(_Ended(key, result))

    def _do(self, lease: Lease, cancelled: Callable[[], bool]) -> Result:
        try:
            return wire.checked(self._service.do(lease.work, cancelled), Result)
        except (Refused, Unavailable) as fault:
            log.warning("lease %s: %s", lease.lease_id, fault)
            unread = (fault.ref,) if isinstance(fault, BlobMissing) else ()
            return Failure(message=told(str(fault)), unread=unread)

    def _measure(self) -> machine.Tick:
        now_s = self._clock.monotonic_s()
        if now_s - self._measured_s < MEASURE_S:
            return machine.Tick()
        self._measured_s = now_s
        memory_mib = resident_mib(os.getpid()) if self._measures % MEMORY_EVERY == 0 else 0.0
        self._measures += 1
        return machine.Tick(memory_mib, processor_s(os.getpid()))


def _decoded(reply: Reply, kind: type[T]) -> T | None:
    if reply.refused:
        log.warning("refused by the books: %s", reply.refused)
    if reply.payload is None:
        return None
    try:
        return wire.decode(reply.payload, kind)
    except Refused as fault:
        log.warning("unreadable answer: %s", fault)
        return None
