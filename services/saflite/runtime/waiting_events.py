"""Events that a receiver has yet to take, on disk beside the cursor of their bridge: the farm may end meanwhile.

A file of records: length and CRC-32 of an event's bytes, then these. What a process that died left half written is cut
off when the file is opened; what stands at or before the cursor was taken, and goes once all was.
"""

from __future__ import annotations

import fcntl
import os
import stat
import struct
import threading
import zlib
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import msgspec

from saflite.contract import wire
from saflite.contract.cloud_event import told_as
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import Event, kind_of
from saflite.evidence.files import flush
from saflite.runtime.webhook import Cursor, keep_cursor, read_cursor

BYTES_MAX = 64 * 2**20  # no more is fetched then until all that waits was taken; some 200,000 events
TAKEN_BYTES_MAX = 2**20  # so much may stay of what was taken
_HEAD = struct.Struct("<II")


def waiting_file(cursor_file: Path) -> Path:
    """Return where events wait for a receiver."""
    return cursor_file.with_name(f"{cursor_file.name}.waiting")


class WaitingEvents:
    """Events of the kinds asked for (all if empty) that wait, and the cursor: one thread adds, another takes.

    `cursor` is None until it is known which run is told. `fetched_seq` is the last event that was added or passed over.
    """

    def __init__(self, cursor_file: Path, kinds: frozenset[str]) -> None:
        """Open what an earlier bridge left.

        Raises:
            Refused: another bridge works with it, or it is no file, or the cursor is none.
            Unavailable: the disk fails.
        """
        self._cursor_file, self._kinds = cursor_file, kinds
        self.cursor = read_cursor(cursor_file)
        self.file = waiting_file(cursor_file)
        self._handle = _opened(self.file)
        self._changed = threading.Condition()
        self._waiting: deque[bytes] = deque()
        self._lent = b""
        self._bytes = self.fetched_seq = 0
        if self.cursor is not None and self.cursor.covers(kinds):
            # on disk before anything is added: what is passed over from now on was not told
            self._keep(msgspec.structs.replace(self.cursor, kinds=tuple(sorted(kinds))))
            self._flush_cursor()
            self._read(self.cursor)
        else:
            self.cursor = None
            self._cut(0)

    @property
    def next_seq(self) -> int:
        """The number of the event to add next."""
        return self.fetched_seq + 1

    @property
    def waits(self) -> int:
        """How many events wait."""
        with self._changed:
            return len(self._waiting)

    @property
    def is_full(self) -> bool:
        """Whether no more should be added until all was taken."""
        with self._changed:
            return self._bytes >= BYTES_MAX

    @property
    def last(self) -> Event | None:
        """The last event that waits, None if none does."""
        with self._changed:
            return wire.decode(self._waiting[-1], Event) if self._waiting else None

    def kept(self) -> Iterator[Event]:
        """Yield the events of the file, those that were taken, too. Before anything is added."""
        self._bytes = 0
        for data in self._records():
            yield wire.decode(data, Event)

    def begin(self, cursor: Cursor) -> None:
        """Go on from a cursor; nothing waits any more."""
        with self._changed:
            self._waiting.clear()
            self._cut(0)
            self._keep(cursor)
            self.fetched_seq = cursor.seq

    def add(self, event: Event) -> None:
        """Have an event wait, or pass it over; the campaign has not ended. Raises Unavailable if the disk fails."""
        with self._changed:
            self.go_on()
            if not self._kinds or kind_of(event.fact) in self._kinds:
                data = wire.encode(event)
                self._write(_HEAD.pack(len(data), zlib.crc32(data)) + data)
                self._waiting.append(data)
                self._changed.notify()
            self.fetched_seq = event.seq

    def flush(self) -> None:
        """Have what was added on disk for good; raises Unavailable if the disk fails."""
        try:
            os.fsync(self._handle)
        except OSError as fault:
            raise Unavailable(f"{self.file}: {fault}") from fault

    def end(self) -> None:
        """Note that the campaign has ended and nothing is left to add."""
        self.flush()
        with self._changed:
            self._keep(msgspec.structs.replace(self._known(), end=self.fetched_seq))

    def go_on(self) -> None:
        """Note that the campaign has not ended."""
        with self._changed:
            if self._known().end:
                self._keep(msgspec.structs.replace(self._known(), end=0))

    def first(self, wait_s: float) -> tuple[Event, Cursor] | None:
        """Return the event to be taken next and the cursor before it; None if there is none within `wait_s`."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._waiting, wait_s):
                return None
            self._lent = self._waiting[0]
            return wire.decode(self._lent, Event), self._known()

    def taken(self, event: Event) -> None:
        """Move the cursor behind the first event, unless `begin` was called since. Raises Unavailable."""
        with self._changed:
            if not self._waiting or self._waiting[0] is not self._lent:
                return
            self._keep(msgspec.structs.replace(self._known(), seq=event.seq, told_as=told_as(event)))
            self._waiting.popleft()
            if not self._waiting and self._bytes > TAKEN_BYTES_MAX:
                self._flush_cursor()  # first: an older one would not show that there was something between
                self._cut(0)

    def close(self, *, over: bool) -> None:
        """Let others open it; `over`: nothing waits and nothing will."""
        with self._changed:
            os.close(self._handle)
            if over:
                self.file.unlink(missing_ok=True)

    def _known(self) -> Cursor:
        assert self.cursor is not None, "which run is told?"
        return self.cursor

    def _keep(self, cursor: Cursor) -> None:
        keep_cursor(self._cursor_file, cursor)
        self.cursor = cursor

    def _flush_cursor(self) -> None:
        try:
            flush(self._cursor_file)
            flush(self._cursor_file.parent)
        except OSError as fault:
            raise Unavailable(f"{self._cursor_file}: {fault}") from fault

    def _read(self, cursor: Cursor) -> None:
        self.fetched_seq = max(cursor.seq, cursor.end)
        for data in self._records():
            event = wire.decode(data, Event)
            self.fetched_seq = max(self.fetched_seq, event.seq)
            if event.seq > cursor.seq and (not self._kinds or kind_of(event.fact) in self._kinds):
                self._waiting.append(data)
        self._cut(self._bytes)

    def _records(self) -> Iterator[bytes]:
        """Yield the whole records; `_bytes` is where the last of them ends."""
        os.lseek(self._handle, 0, os.SEEK_SET)
        with os.fdopen(os.dup(self._handle), "rb") as file:
            while len(head := file.read(_HEAD.size)) == _HEAD.size:
                length, checksum = _HEAD.unpack(head)
                data = file.read(min(length, wire.MESSAGE_BYTES_MAX))
                if len(data) != length or zlib.crc32(data) != checksum:
                    return
                yield data
                self._bytes += _HEAD.size + length

    def _write(self, record: bytes) -> None:
        try:
            written = os.write(self._handle, record)
        except OSError as fault:
            raise Unavailable(f"{self.file} takes no event: {fault}") from fault
        if written != len(record):
            self._cut(self._bytes)
            raise Unavailable(f"{self.file} takes no event: the disk is full")
        self._bytes += written

    def _cut(self, length: int) -> None:
        try:
            os.ftruncate(self._handle, length)
        except OSError as fault:
            raise Unavailable(f"{self.file}: {fault}") from fault
        self._bytes = length


def _opened(path: Path) -> int:
    """Return a file to read and append to, for this user and this process only."""
    flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    handle = os.open(path, flags, 0o600)
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise Refused("--cursor", where=str(path), expected="a regular file beside it", got="something else")
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as fault:
        os.close(handle)
        raise Refused(
            "--cursor", where=str(path), expected="one no other bridge works with", got="one in use"
        ) from fault
    except BaseException:
        os.close(handle)
        raise
    return handle
