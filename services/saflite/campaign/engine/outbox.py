"""What the books hand to the store: journal lines, facts, rows, what becomes of blobs. One batch is one transaction."""

from __future__ import annotations

from typing import NamedTuple

from saflite.contract.events import Event, Fact

Value = str | int | float | bytes | None


class Row(NamedTuple):
    """One row of a plain table; a row with the same key takes the place of the older one."""

    table: str
    values: tuple[Value, ...]


class Batch(NamedTuple):
    """All that changed since the last batch.

    `lines` are encoded journal lines, `first_line` of them came before. Of blobs (by digest), `flushed` ones are to be
    safe on disk before the commit, `dropped` ones may go after it, `published` ones get a name for people besides.
    """

    first_line: int
    lines: tuple[bytes, ...]
    events: tuple[Event, ...]
    rows: tuple[Row, ...]
    dropped: tuple[str, ...]
    flushed: tuple[str, ...] = ()
    published: tuple[tuple[str, str], ...] = ()

    def __bool__(self) -> bool:
        return any(self[1:])


class Outbox:
    """Collects what the next batch will hold. While `replaying`, lines are counted and nothing else is kept."""

    def __init__(self) -> None:
        self.seq = 0
        self.line_count = 0
        self.replaying = False
        self._unix_offset_s = 0.0
        self._lines: list[bytes] = []
        self._events: list[Event] = []
        self._rows: list[Row] = []
        self._dropped: dict[str, None] = {}
        self._flushed: dict[str, None] = {}
        self._published: dict[str, str] = {}

    def set_wall_time(self, at_s: float, unix_s: float) -> None:
        """Say what wall time the books' clock stands for."""
        self._unix_offset_s = unix_s - at_s

    def unix_s(self, at_s: float) -> float:
        """Return the wall time of a moment on the books' clock."""
        return at_s + self._unix_offset_s

    def begin_line(self) -> None:
        """Count the journal line whose facts and rows come next."""
        self.line_count += 1

    def line(self, data: bytes) -> None:
        """Add the journal line begun last."""
        if not self.replaying:
            self._lines.append(data)

    def fact(self, fact: Fact, at_s: float) -> None:
        """Announce a fact with the next number in the campaign's history."""
        self.seq += 1
        if not self.replaying:
            self._events.append(Event(seq=self.seq, at_unix_s=self.unix_s(at_s), fact=fact))

    def row(self, table: str, *values: Value) -> None:
        """Add a row for people."""
        if not self.replaying:
            self._rows.append(Row(table, values))

    def keep_blob(self, digest: str) -> None:
        """Have a blob not removed after all."""
        self._dropped.pop(digest, None)

    def drop_blob(self, digest: str) -> None:
        """Have a blob removed."""
        if not self.replaying:
            self._dropped[digest] = None

    def flush_blob(self, digest: str) -> None:
        """Have a blob safe on disk with the next batch: it is kept."""
        if not self.replaying:
            self._flushed[digest] = None

    def publish_blob(self, file: str, digest: str) -> None:
        """Let a blob stand under a name for people, too, relative to the run folder."""
        if not self.replaying:
            self._published[file] = digest

    @property
    def waiting(self) -> bool:
        """Whether something waits for the next batch."""
        return bool(self._lines or self._events or self._rows or self._dropped)

    def drain(self) -> Batch:
        """Return all that was collected and begin anew."""
        batch = Batch(
            self.line_count - len(self._lines),
            tuple(self._lines),
            tuple(self._events),
            tuple(self._rows),
            tuple(self._dropped),
            tuple(self._flushed),
            tuple(self._published.items()),
        )
        self._lines, self._events, self._rows = [], [], []
        self._dropped, self._flushed, self._published = {}, {}, {}
        return batch
