"""A participant that breaks the rules: reports false scores, sends damaged, oversized and replayed messages."""

from __future__ import annotations

import queue
import threading
from typing import Any, ClassVar, TypeVar

import msgspec
import numpy as np
from mutations import drawn, encoded

from saflite.bus.base import seal
from saflite.bus.zenoh import ZenohBus, open_client
from saflite.contract import topics, wire
from saflite.contract.blobs import BlobPut, ref_of
from saflite.contract.control import Control
from saflite.contract.flight import Flight
from saflite.contract.join import Joined
from saflite.contract.score import Score
from saflite.contract.test_case import identity
from saflite.contract.work import (
    Ask,
    Failure,
    FlyResult,
    Grant,
    Heartbeat,
    Lease,
    Orders,
    Receipt,
    Report,
    Result,
    ScoreResult,
    ScoreWork,
    Stage,
)
from saflite.runtime.clock import WallClock
from saflite.runtime.software import card_of

T = TypeVar("T")

BURST = 20
ROGUE_BURST, ROGUE_WAIT_S = 60, 1.0
GRAB_S = 5.0
GRABS = 6


class ByzantineClient(threading.Thread):
    """Commits one kind of fault at a time, in its own thread."""

    FALSE_RESULTS: ClassVar[tuple[str, ...]] = (
        "scorer answers garbage",
        "scorer hangs",
        "scorer is slow",
        "replayed result",
        "rogue peer",
    )
    DAMAGE: ClassVar[tuple[str, ...]] = ("flipped messages", "truncated messages", "oversized message")

    def __init__(self, name: str, endpoint: str, campaign: str, rng: np.random.Generator) -> None:
        super().__init__(daemon=True)
        self._name = name
        self._endpoint, self._campaign, self._rng, self._clock = endpoint, campaign, rng, WallClock()
        self._faults: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._replies: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._busy = threading.Event()
        self._tag = 0
        self._session = ""
        self._bus: ZenohBus | None = None
        self.messages = self.damaged_taken = self.garbage_taken = self.replays_taken = self.replays = self.rogue = 0
        self.committed: dict[str, int] = {}

    def start_fault(self, name: str) -> bool:
        """Commit a fault unless another is under way; returns whether it began."""
        if self._busy.is_set():
            return False
        self._busy.set()
        self._faults.put(name)
        return True

    def end(self) -> None:
        """Stop playing."""
        self._faults.put(None)
        self.join(GRABS * GRAB_S)

    def run(self) -> None:
        """Play what is asked for until the end."""
        self._bus = open_client(self._name, self._endpoint, insecure=True)
        while (name := self._faults.get()) is not None:
            if self._play(name):
                self.committed[name] = self.committed.get(name, 0) + 1
            self._busy.clear()
        self._bus.close()

    # -- kinds ---------------------------------------------------------------------------------------------------

    def _play(self, name: str) -> bool:
        if name == "flipped messages":
            return self._damaged(self._flipped)
        if name == "truncated messages":
            return self._damaged(lambda data: data[: int(self._rng.integers(len(data)))])
        if name == "oversized message":
            return self._oversized()
        lease = self._grab("score")
        if lease is None or not isinstance(lease.work, ScoreWork):
            return False
        if name == "scorer answers garbage":
            self.garbage_taken += self._report(lease, self._garbage(lease.work)) == "accepted"
        elif name == "rogue peer":
            self._rogue(lease, lease.work)
        elif name == "scorer hangs":
            self._hold(lease, 3.0)
        elif name == "scorer is slow":
            self._hold(lease, 1.0)
            self._report(lease, _scores(lease.work))
        else:
            self._replay(lease, lease.work)
        return True

    def _garbage(self, work: ScoreWork) -> Result:
        good = _scores(work).scores
        first = good[0]
        false_results: list[Result] = [
            ScoreResult(scores=()),
            ScoreResult(scores=good[1:]),
            ScoreResult(scores=(*good, first)),
            ScoreResult(scores=(msgspec.structs.replace(first, test_case="0" * 16), *good[1:])),
            ScoreResult(scores=(msgspec.structs.replace(first, value=11.0), *good[1:])),
            ScoreResult(scores=(msgspec.structs.replace(first, value=float("nan")), *good[1:])),
            FlyResult(flight=Flight(test_case=first.test_case, flight_index=0, ending="completed")),
        ]
        return false_results[int(self._rng.integers(len(false_results)))]

    def _replay(self, lease: Lease, work: ScoreWork) -> None:
        result = _scores(work)
        if self._report(lease, result) != "accepted":
            return
        for _ in range(3):
            self.replays += 1
            self.replays_taken += self._report(lease, result) == "accepted"

    def _rogue(self, lease: Lease, work: ScoreWork) -> None:
        """Say wrong things of every kind in its own name, its lease's result among them."""
        status, events = Control(verb="status"), Control(verb="events", number=1)
        report = Report(worker=self._name, lease_id=lease.lease_id, epoch=lease.epoch, result=_scores(work))
        samples: list[tuple[str, msgspec.Struct]] = [
            (topics.join(self._campaign, "score"), card_of("score", f"{self._name}-2", self._clock)),
            (topics.beat(self._campaign, "score"), Heartbeat(worker=self._name, stage="score", session=self._session)),
            (topics.control(self._campaign, "status"), status),
            (topics.control(self._campaign, "events"), events),
            (topics.blob(self._campaign, "put"), BlobPut(worker=self._name, ref=ref_of(b"x"), data=b"x")),
            (topics.result(self._campaign, "score"), report),
        ]
        for number in range(ROGUE_BURST):
            key, message = samples[number % len(samples)]
            said = msgspec.to_builtins(message, builtin_types=(bytes,))
            data = encoded(drawn(said, self._rng)[0])
            self._send(key, data, seal(key, self._name, data), ROGUE_WAIT_S)
            self.rogue += 1

    def _hold(self, lease: Lease, duration_s: float) -> None:
        until_s = self._clock.monotonic_s() + duration_s
        while self._clock.monotonic_s() < until_s:
            beat = Heartbeat(
                worker=self._name,
                stage="score",
                session=self._session,
                leases=((lease.lease_id, lease.epoch),),
                state="busy",
            )
            self._ask(topics.beat(self._campaign, "score"), beat, Orders)
            self._clock.sleep_s(0.4)

    def _damaged(self, damage: Any) -> bool:
        samples = self._samples()
        for number in range(BURST):
            key, data = samples[number % len(samples)]
            reply = self._send(key, damage(data), seal(key, self._name, data))
            self.damaged_taken += reply.payload is not None
        return True

    def _flipped(self, data: bytes) -> bytes:
        body = bytearray(data)
        body[int(self._rng.integers(len(body)))] ^= 1 << int(self._rng.integers(8))
        return bytes(body)

    def _oversized(self) -> bool:
        key = topics.result(self._campaign, "fly")
        data = wire.encode(Report(worker=self._name, lease_id="x", epoch=1, result=Failure(message="x" * (33 * 2**20))))
        answer = self._send(key, data, seal(key, self._name, data)).payload  # it arrives whole: a receipt refuses it
        self.damaged_taken += answer is not None and wire.decode(answer, Receipt).status == "accepted"
        return True

    def _samples(self) -> list[tuple[str, bytes]]:
        report = Report(worker="fly-1", lease_id="x:fly/x/search/0", epoch=1, result=Failure(message="m"))
        return [
            (topics.work(self._campaign, "fly"), wire.encode(Ask(worker="fly-1", stage="fly", wait_s=0.0))),
            (topics.result(self._campaign, "fly"), wire.encode(report)),
            (topics.beat(self._campaign, "fly"), wire.encode(Heartbeat(worker="fly-1", stage="fly"))),
        ]

    # -- asking --------------------------------------------------------------------------------------------------

    def _grab(self, stage: Stage) -> Lease | None:
        card = card_of(stage, self._name, self._clock)
        for _ in range(GRABS):
            joined = self._ask(topics.join(self._campaign, stage), card, Joined)
            self._session = card.session if joined is not None and joined.accepted else ""
            ask = Ask(worker=self._name, stage=stage, session=self._session, wait_s=GRAB_S)
            grant = self._ask(topics.work(self._campaign, stage), ask, Grant)
            if grant is not None and grant.leases:
                return grant.leases[0]
            self._clock.sleep_s(0.1)
        return None

    def _report(self, lease: Lease, result: Result) -> str:
        report = Report(worker=self._name, lease_id=lease.lease_id, epoch=lease.epoch, result=result)
        receipt = self._ask(topics.result(self._campaign, "score"), report, Receipt)
        return "" if receipt is None else receipt.status

    def _ask(self, key: str, message: msgspec.Struct, kind: type[T]) -> T | None:
        data = wire.encode(message)
        reply = self._send(key, data, seal(key, self._name, data))
        return None if reply.payload is None else wire.decode(reply.payload, kind)

    def _send(self, key: str, payload: bytes, attachment: bytes, within_s: float = GRAB_S + 5.0) -> Any:
        assert self._bus is not None
        self._tag += 1
        self.messages += 1
        self._bus.ask(key, payload, self._tag, self._replies.put, within_s, attachment=attachment)
        while True:
            reply = self._replies.get()
            if reply.tag == self._tag:
                return reply


def _scores(work: ScoreWork) -> ScoreResult:
    names = [identity(case) for case in work.test_cases]
    scores = [Score(test_case=name, value=5.0, model=work.model, scored_by=work.model) for name in names]
    return ScoreResult(scores=tuple(scores))
