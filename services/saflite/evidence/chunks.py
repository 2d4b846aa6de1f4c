"""Blobs in chunks, for who cannot see the folder: the serving side, and the two ways through for the asking side.

All are plain state machines over the messages of `contract.blobs`; who sends those, and how often, is not their
matter. Either way can be taken up again where it stopped: the asking side says from where, the serving side how far
it is.
"""

from __future__ import annotations

from pathlib import Path

from saflite.contract.blobs import (
    CHUNK_BYTES_MAX,
    BlobChunk,
    BlobGet,
    BlobMissing,
    BlobPut,
    BlobRef,
    BlobTaken,
    check_ref,
)
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.ids import digest
from saflite.evidence import files
from saflite.evidence.folder import BlobFolder

RESTARTS_MAX = 3
CHUNK_S = 2.0  # how long a chunk should be under way: heartbeats come between, and the way may become slower
CHUNK_FIRST_BYTES, CHUNK_BYTES_MIN = 2**16, 2**13
LOST_SHRINKS = 4


class OverQuota(Refused):
    """Too much is left that the books have not answered for."""


class ChunkServer:
    """Answers `BlobGet` and `BlobPut` from a folder; holds one chunk in memory at most."""

    def __init__(self, blobs: BlobFolder) -> None:
        self._blobs = blobs
        self.quota = blobs.quota()

    def get(self, ask: BlobGet) -> BlobChunk:
        """Return a stretch of a blob; raises Refused for a question that makes no sense."""
        check_ref(BlobRef(digest=ask.digest, size_bytes=0))
        if ask.offset < 0 or not 0 < ask.length <= CHUNK_BYTES_MAX:
            expected = f"an offset of 0 or more and a length of 1 to {CHUNK_BYTES_MAX}"
            raise Refused("blob", expected=expected, got=(ask.offset, ask.length))
        try:
            with self._blobs.path(ask.digest).open("rb") as file:
                size_bytes = file.seek(0, 2)
                file.seek(ask.offset)
                return BlobChunk(size_bytes=size_bytes, data=file.read(ask.length))
        except OSError:
            return BlobChunk(size_bytes=-1)

    def put(self, ask: BlobPut) -> BlobTaken:
        """Take a stretch of a blob; the digest is checked with the last one.

        Raises:
            Refused: the stretch makes no sense, or all of them together are not the blob.
            OverQuota: the worker, or all of them, left too much already.
            Unavailable: the disk does not take it.
        """
        check_ref(ask.ref)
        whole = self._blobs.incoming(ask.worker) / ask.ref.digest
        if not 0 <= ask.offset <= ask.offset + len(ask.data) <= ask.ref.size_bytes or len(ask.data) > CHUNK_BYTES_MAX:
            expected = f"at most {CHUNK_BYTES_MAX} bytes within the {ask.ref.size_bytes} of the blob"
            raise Refused("blob", expected=expected, got=f"{len(ask.data)} bytes from {ask.offset} on")
        if not files.fault_of(whole, ask.ref, deep=False):
            return BlobTaken(have_bytes=ask.ref.size_bytes)
        if words := self.quota.excess(ask.worker, ask.ref.size_bytes - ask.offset):
            raise OverQuota("blob", expected="room for it", got=words)
        try:
            return BlobTaken(have_bytes=_append(whole, ask, self._blobs.within))
        except OSError as fault:
            raise Unavailable(f"{whole.parent} takes no blob: {fault}") from fault


def _append(whole: Path, ask: BlobPut, within: Path | None) -> int:
    part = whole.with_name(whole.name + files.PART)
    files.make_folder(part.parent, within)
    with part.open("ab") as file:
        have = file.tell()
        if have == ask.offset:
            have += file.write(ask.data)
    if have < ask.ref.size_bytes:
        return have
    if files.fault_of(part, ask.ref, deep=True):
        part.unlink()
        files.remove_if_empty(part.parent)
        raise Refused("blob", expected=f"bytes with the digest {ask.ref.digest[:16]!r}...", got="other bytes")
    part.replace(whole)
    return have


class Pace:
    """How much goes into a chunk: what the way carries in `CHUNK_S`, by what the chunks before took."""

    def __init__(self) -> None:
        self.chunk_bytes = min(CHUNK_FIRST_BYTES, CHUNK_BYTES_MAX)

    def took(self, chunk_bytes: int, took_s: float) -> None:
        """Learn from a chunk that was answered; one that was not full says little."""
        if chunk_bytes >= self.chunk_bytes:
            fits = chunk_bytes * min(2.0, CHUNK_S / max(took_s, 1e-3))
            self.chunk_bytes = min(CHUNK_BYTES_MAX, max(CHUNK_BYTES_MIN, int(fits)))

    def lost(self) -> None:
        """Learn from a chunk that nobody answered in time."""
        self.chunk_bytes = min(self.chunk_bytes, max(CHUNK_BYTES_MIN, self.chunk_bytes // LOST_SHRINKS))


class Upload:
    """Leaves a blob: send what `ask` returns and `take` the answer, until `ask` returns None."""

    def __init__(self, worker: str, ref: BlobRef, data: bytes, pace: Pace | None = None) -> None:
        self._worker, self._ref, self._data = worker, ref, memoryview(data)
        self._have_bytes = 0
        self._restarts = 0
        self._sure, self._pace = False, pace or Pace()

    def ask(self) -> BlobPut | None:
        """Return the next stretch; the first question, and one after silence, only is how much is there already."""
        if self._sure and self._have_bytes == self._ref.size_bytes:
            return None
        at = self._have_bytes
        data = bytes(self._data[at : at + self._pace.chunk_bytes]) if self._sure else b""
        return BlobPut(worker=self._worker, ref=self._ref, offset=at, data=data)

    def take(self, answer: BlobTaken) -> None:
        """Go on from where the other side is; raises Unavailable if that falls back again and again."""
        self._restarts += answer.have_bytes < self._have_bytes
        if self._restarts > RESTARTS_MAX or not 0 <= answer.have_bytes <= self._ref.size_bytes:
            raise Unavailable(
                f"blob {self._ref.digest[:16]} is not taken: {answer.have_bytes} bytes are said to be there"
            )
        self._have_bytes, self._sure = answer.have_bytes, True

    def unanswered(self) -> None:
        """Nobody answered in time: the stretch may still be under way, and the same again would queue behind it."""
        if self._sure:
            self._pace.lost()
        self._sure = False


class Download:
    """Gets a blob: send what `ask` returns and `take` the answer, until `ask` returns None."""

    def __init__(self, ref: BlobRef, pace: Pace | None = None) -> None:
        check_ref(ref)
        self._ref, self._data, self._pace = ref, bytearray(), pace or Pace()
        self._begun = False

    def ask(self) -> BlobGet | None:
        """Return the next question; a blob of no bytes is asked for once, too."""
        if self._begun and len(self._data) == self._ref.size_bytes:
            return None
        return BlobGet(digest=self._ref.digest, offset=len(self._data), length=self._pace.chunk_bytes)

    def take(self, answer: BlobChunk) -> None:
        """Take a stretch; raises BlobMissing where the other side has no such blob."""
        self._begun = True
        if answer.size_bytes < 0:
            raise BlobMissing(self._ref, "is missing")
        more = self._ref.size_bytes - len(self._data)  # who sends beyond the end would be asked on for ever
        if answer.size_bytes != self._ref.size_bytes or len(answer.data) > more or (more and not answer.data):
            raise BlobMissing(self._ref, "is damaged")
        self._data += answer.data

    def unanswered(self) -> None:
        """Nobody answered in time: ask for less."""
        self._pace.lost()

    def result(self) -> bytes:
        """Return the whole blob; raises BlobMissing if its digest is another."""
        data = bytes(self._data)
        if digest(data) != self._ref.digest:
            raise BlobMissing(self._ref, "is damaged")
        return data
