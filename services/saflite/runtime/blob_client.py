"""How a worker reaches the blobs of the run: in the folder if it can see it, otherwise over the bus."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, Protocol, TypeVar

import msgspec

from saflite.bus.base import Bus, Happening, Reply
from saflite.contract import topics, wire
from saflite.contract.blobs import (
    BlobChunk,
    BlobOpen,
    BlobOpened,
    BlobPut,
    BlobRef,
    Blobs,
    BlobTaken,
    ref_of,
)
from saflite.contract.errors import Unavailable
from saflite.contract.work import Report, blobs_left
from saflite.evidence.chunks import Download, Pace, Upload
from saflite.evidence.folder import WorkerFolder

log = logging.getLogger(__name__)

ANSWER_S = 10.0
PATIENCE_S = 120.0  # without any answer: books that restart are back long before
PAUSE_S = 0.2
BlobVerb = Literal["open", "get", "put"]
Question = Callable[[], msgspec.Struct | None]
T = TypeVar("T")


class SleepingClock(Protocol):
    """A clock that can wait."""

    def monotonic_s(self) -> float:
        """Return seconds that never go back."""
        ...

    def sleep_s(self, duration_s: float) -> None:
        """Wait."""
        ...


class BusBlobs:
    """A worker's end of the store over the bus. See `contract.blobs.Blobs`. May be used from several threads.

    Chunks are as large as the way to the books carries in time, which is learnt from one blob for the next.
    """

    def __init__(self, bus: Bus, campaign: str, worker: str, clock: SleepingClock) -> None:
        self._bus, self._campaign, self._worker, self._clock = bus, campaign, worker, clock
        self._pace = Pace()

    def open(self, keep: Sequence[str]) -> str:
        """Say that an earlier life left nothing but `keep` of use; returns what the store's probe says."""
        message = BlobOpen(worker=self._worker, keep=tuple(keep))
        return self._asked("open", lambda: message, BlobOpened, _nothing).probe

    def put(self, data: bytes) -> BlobRef:
        """See `Blobs.put`."""
        ref = ref_of(data)
        upload = Upload(self._worker, ref, data, self._pace)
        while upload.ask() is not None:
            upload.take(self._asked("put", upload.ask, BlobTaken, upload.unanswered))
        return ref

    def get(self, ref: BlobRef) -> bytes:
        """See `Blobs.get`."""
        download = Download(ref, self._pace)
        while download.ask() is not None:
            download.take(self._asked("get", download.ask, BlobChunk, download.unanswered))
        return download.result()

    def _asked(
        self,
        verb: BlobVerb,
        question: Question,
        kind: type[T],
        unanswered: Callable[[], None],
    ) -> T:
        """Ask until there is an answer; what is asked after silence may be another `question`.

        Raises:
            Unavailable: the books do not take the question, or do not answer in time.
        """
        key, until_s = topics.blob(self._campaign, verb), self._clock.monotonic_s() + PATIENCE_S
        while True:
            inbox: queue.SimpleQueue[Happening] = queue.SimpleQueue()
            message, asked_s = question(), self._clock.monotonic_s()
            assert message is not None, "there is more to ask until there is an answer"
            self._bus.ask(key, wire.encode(message), "blob", inbox.put, ANSWER_S)
            reply = inbox.get()
            assert isinstance(reply, Reply), "the answer to a question is a reply"
            if reply.refused:
                raise Unavailable(f"refused by the books: {reply.refused}")
            if reply.payload is not None:
                answer = wire.decode(reply.payload, kind)
                self._pace.took(_carried_bytes(message, answer), self._clock.monotonic_s() - asked_s)
                return answer
            if self._clock.monotonic_s() > until_s:
                raise Unavailable(f"the books did not answer on {key} for {PATIENCE_S:.0f} s")
            unanswered()
            self._clock.sleep_s(PAUSE_S)


def _carried_bytes(*messages: object) -> int:
    return sum(len(message.data) for message in messages if isinstance(message, BlobPut | BlobChunk))


def _nothing() -> None:
    return


class WorkerBlobs:
    """A worker's way to the blobs of the run, found when it is first needed: by then the worker has joined.

    That `run_dir` is the folder the books use is proven by what the store's probe says, never assumed. `spooled` are
    results still to be reported: of what an earlier life left, their blobs are kept.
    """

    def __init__(self, over_bus: BusBlobs, worker: str, run_dir: Path | None, spooled: Sequence[Report]) -> None:
        self._over_bus, self._worker, self._run_dir = over_bus, worker, run_dir
        self._keep = [blob.digest for report in spooled for blob in blobs_left(report.result)]
        self._found: Blobs | None = None
        self._finding = threading.Lock()

    def put(self, data: bytes) -> BlobRef:
        """See `Blobs.put`."""
        return self._way().put(data)

    def get(self, ref: BlobRef) -> bytes:
        """See `Blobs.get`."""
        return self._way().get(ref)

    def _way(self) -> Blobs:
        with self._finding:
            self._found = self._found or self._find()
            return self._found

    def _find(self) -> Blobs:
        probe = self._over_bus.open(self._keep)
        if self._run_dir is not None and WorkerFolder.sees(self._run_dir, self._worker, probe):
            return WorkerFolder(self._run_dir, self._worker)
        log.info("blobs travel over the bus: the folder of the books is not seen from here")
        return self._over_bus
