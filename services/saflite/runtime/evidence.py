"""The blobs' side of the books: checks what results name, and serves blobs over the bus, in a thread of its own.

Reading and hashing large files must not keep the books waiting, so a result that names blobs is looked at here first
and comes back to the books with what was found. Small blobs are looked at on the spot: to hand them to another thread
takes longer, and more of both. Requests over the bus wait in a line that holds a bounded number of them for each key;
one that finds no room is not answered, and asked again.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from typing import NamedTuple, Protocol

import msgspec

from saflite.bus.access import check_speaker
from saflite.bus.base import Bus, Happening, Request
from saflite.contract import topics, wire
from saflite.contract.blobs import BlobGet, BlobMissing, BlobOpen, BlobOpened, BlobPut
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import Flight, matches_digest
from saflite.contract.work import Failure, FlyResult, Report, blobs_left
from saflite.evidence.chunks import ChunkServer, OverQuota
from saflite.evidence.folder import BlobFolder

log = logging.getLogger(__name__)

REQUESTS_MAX = 64  # of at most one chunk each
SMALL_BYTES = 2**16  # of all blobs of a result

Then = Callable[[str | None], None]
"""Takes in words what is wrong with the blobs of a result, empty if nothing is; None if that cannot be told now."""


OwnerOf = Callable[[str], str | None]
"""Tells by which key a worker joined, empty for the farm's own user; None if nobody of that name has joined."""


class Evidence(Protocol):
    """Looks at blobs for the books."""

    def inspect(self, report: Report, then: Then) -> None:
        """Take the blobs a result names into the store, or look at those it says cannot be read."""
        ...

    def answered(self, report: Report) -> None:
        """Forget what the worker left: the books have answered and committed."""
        ...


class InlineEvidence:
    """Looks at once, in the thread of the caller."""

    def __init__(self, blobs: BlobFolder) -> None:
        self._blobs = blobs

    def inspect(self, report: Report, then: Then) -> None:
        """See `Evidence.inspect`."""
        then(look(self._blobs, report))

    def answered(self, report: Report) -> None:
        """See `Evidence.answered`."""
        self._blobs.forget(report.worker, [blob.digest for blob in blobs_left(report.result)])


def look(blobs: BlobFolder, report: Report) -> str | None:
    """Return what is wrong with the blobs of a result, see `Then`."""
    result = report.result
    try:
        if isinstance(result, Failure):
            return ", ".join(_faults(blobs, result))
        for blob in dict.fromkeys(blobs_left(result)):
            if fault := blobs.adopt(report.worker, blob):
                return f"blob {blob.digest[:16]} is {fault}"
        if isinstance(result, FlyResult):
            return _trace_fault(blobs, result.flight)
    except (Refused, BlobMissing) as fault:
        return str(fault)
    except Unavailable as fault:
        log.error("nothing is taken until the store of blobs can be written again: %s", fault)
        return None
    return ""


def _is_small(report: Report) -> bool:
    """Whether a result is looked at in no time; traces of re-flights are unpacked besides."""
    result = report.result
    is_first = isinstance(result, FlyResult) and result.flight.flight_index == 0
    return is_first and sum(blob.size_bytes for blob in blobs_left(result)) <= SMALL_BYTES


def _trace_fault(blobs: BlobFolder, flight: Flight) -> str:
    """Return whether a re-flight claims the digest of another trace: if it is that of the first, nobody judges it.

    Unpacking is what costs most here; the traces of first flights are unpacked, and checked, by the oracle.
    """
    if flight.trace is None or flight.flight_index == 0 or matches_digest(blobs.get(flight.trace), flight.trace_digest):
        return ""
    return f"the trace is not the one with the digest {flight.trace_digest[:16]!r}"


def _faults(blobs: BlobFolder, result: Failure) -> list[str]:
    found = [(blob, blobs.fault(blob, deep=True)) for blob in dict.fromkeys(result.unread)]
    return [f"blob {blob.digest[:16]} is {fault}" for blob, fault in found if fault]


class _Inspect(NamedTuple):
    report: Report
    then: Then


class _Answered(NamedTuple):
    report: Report


class EvidenceService:
    """Looks, and serves blobs over the bus, in its own thread."""

    def __init__(self, bus: Bus, campaign: str, blobs: BlobFolder) -> None:
        self._inline, self._requests = InlineEvidence(blobs), BlobRequests(blobs)
        self._inbox: queue.SimpleQueue[Happening | _Inspect | _Answered | None] = queue.SimpleQueue()
        self._rooms: dict[str, threading.BoundedSemaphore] = {}  # of each key, and of the farm's own user
        self._broken: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="evidence", daemon=True)
        bus.serve(f"{topics.prefix(campaign)}/blob/*", self._queue)
        self._thread.start()

    def tell_excess(self, told: Callable[[str, str], None]) -> None:
        """Have somebody told, from the thread of the blobs, who leaves too much and how much that is."""
        self._requests.on_excess = told

    def heed(self, owner_of: OwnerOf, key_of: Callable[[str], str]) -> None:
        """Let nobody speak for a worker that joined by another key; asked from the thread of the blobs.

        `key_of` tells whose key a worker's name begins with, empty where nobody's: each has its share of the room.
        """
        self._requests.owner_of = owner_of
        self._requests.share(key_of)

    def inspect(self, report: Report, then: Then) -> None:
        """See `Evidence.inspect`."""
        assert self._broken is None, f"the thread of the blobs died: {self._broken!r}"
        if _is_small(report):
            self._inline.inspect(report, then)
        else:
            self._inbox.put(_Inspect(report, then))

    def answered(self, report: Report) -> None:
        """See `Evidence.answered`."""
        if _is_small(report):
            self._inline.answered(report)
        else:
            self._inbox.put(_Answered(report))

    def close(self) -> None:
        """Finish what is under way."""
        self._inbox.put(None)
        self._thread.join()

    def _queue(self, request: Happening) -> None:
        if self._room_of(request).acquire(blocking=False):  # otherwise it is dropped, and asked again
            self._inbox.put(request)

    def _room_of(self, request: Happening) -> threading.BoundedSemaphore:
        peer = "" if isinstance(request, tuple) else request.peer
        return self._rooms.get(peer) or self._rooms.setdefault(peer, threading.BoundedSemaphore(REQUESTS_MAX))

    def _run(self) -> None:
        try:
            while (job := self._inbox.get()) is not None:
                if isinstance(job, _Inspect):
                    self._inline.inspect(job.report, job.then)
                elif isinstance(job, _Answered):
                    self._inline.answered(job.report)
                else:
                    self._room_of(job).release()
                    self._requests.answer(job)
        except BaseException as fault:
            self._broken = fault  # the books hear of it with the next result
            raise


def _not_told(where: str, words: str) -> None:
    log.warning("from %s: %s", where, words)


class BlobRequests:
    """Answers what comes in on `blob/*`."""

    def __init__(self, blobs: BlobFolder) -> None:
        self._blobs, self._chunks = blobs, ChunkServer(blobs)
        self._probe = blobs.make_probe()
        self.on_excess: Callable[[str, str], None] = _not_told
        self.owner_of: OwnerOf = lambda _: None

    def share(self, key_of: Callable[[str], str]) -> None:
        """Let the workers of no key take the room of others; see `Quota.excess`."""
        self._chunks.quota.key_of = key_of

    def answer(self, request: Happening) -> None:
        """Answer or refuse a request; one the disk does not take gets no answer and is asked again."""
        if not isinstance(request, tuple):
            try:
                if request.damaged:
                    raise Refused("blob", expected="the message as it was sent", got=request.damaged)
                request.reply(wire.encode(self._answer(request)))
            except OverQuota as fault:
                self.on_excess(f"{request.sender[:64]} on blob", str(fault))
                request.refuse(str(fault))
            except Refused as fault:
                request.refuse(str(fault))
            except Unavailable as fault:
                log.error("%s", fault)

    def _answer(self, request: Request) -> msgspec.Struct:
        verb = request.key.rpartition("/")[2]
        if verb == "get":
            return self._chunks.get(wire.decode(request.payload, BlobGet))
        if verb == "put":
            put = wire.decode(request.payload, BlobPut)
            check_speaker(request.peer, put.worker, self.owner_of(put.worker))
            return self._chunks.put(put)
        if verb == "open":
            opened = wire.decode(request.payload, BlobOpen)
            check_speaker(request.peer, opened.worker, self.owner_of(opened.worker))
            self._blobs.forget_but(opened.worker, opened.keep)
            return BlobOpened(probe=self._probe)
        raise Refused("blob", expected="open, get or put", got=verb)
