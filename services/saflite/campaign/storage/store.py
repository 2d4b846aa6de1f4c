"""The books on disk: one SQLite file (WAL, synchronous FULL) and a folder of traces. One batch is one transaction.

Every journal line and event carries a running checksum, so a flipped bit is found when the books are opened.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, TypeVar

import msgspec

from saflite.campaign.engine.outbox import Batch, Value
from saflite.campaign.engine.state import Books
from saflite.campaign.storage.blobs import TraceFiles
from saflite.campaign.storage.projections import INSERT
from saflite.campaign.storage.sqlite import (
    check_file,
    checked_chain,
    connect,
    damage_named,
    lock_run,
    make_tables,
    meta,
    transaction,
)
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.contract.events import kind_of
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.work import Outcome

__all__ = ["Batch", "Store", "store_file"]

TRACES = "traces"
T = TypeVar("T")
_OUTCOME = msgspec.msgpack.Decoder(Outcome)


def store_file(run_dir: Path) -> Path:
    """Return the SQLite file of a run folder."""
    return run_dir / "books.sqlite"


class Store:
    """The store of one run, open for writing by one process at a time. Also the read model the books read from."""

    def __init__(self, run_dir: Path, connection: sqlite3.Connection, lock: IO[bytes]) -> None:
        self._path, self._db, self._lock = store_file(run_dir), connection, lock
        self.traces = TraceFiles(run_dir / TRACES)
        self.campaign = self._decoded("campaign", Campaign)
        self.template = self._decoded("template", TestCase)
        self.target = self._decoded("target", TargetInfo)
        self.run_id = self._meta("run_id").decode()
        self._lines, self._chain = self._tail("journal", "n")
        self._seq, self._event_chain = self._tail("events", "seq")

    # ---- making and opening --------------------------------------------------------------------------------------

    @classmethod
    def create(cls, run_dir: Path, campaign: Campaign, template: TestCase, target: TargetInfo) -> Store:
        """Make the store of a new run in `run_dir`; `target` is what the target says of itself now.

        Raises:
            Refused: a run stands there already.
            Unavailable: the disk cannot be written.
        """
        if store_file(run_dir).exists():
            raise Refused(
                "run folder",
                where=str(run_dir),
                expected="a folder without a run in it",
                got="the books of an earlier run",
                fix=f"`saflite resume {run_dir}` goes on with it; or choose another folder",
            )
        try:
            (run_dir / TRACES).mkdir(parents=True, exist_ok=True)
            lock = lock_run(run_dir)
            connection = connect(store_file(run_dir))
            make_tables(connection, campaign, template, target)
        except (OSError, sqlite3.OperationalError) as fault:
            raise Unavailable(f"no store can be made in {run_dir}: {fault}") from fault
        return cls(run_dir, connection, lock)

    @classmethod
    def open(cls, run_dir: Path) -> Store:
        """Open the store of an earlier run to go on with it.

        Raises:
            Refused: there is none, it is in use, damaged, or of another version; the text says what to do.
        """
        path = store_file(run_dir)
        if not path.is_file():
            raise Refused("run folder", where=str(run_dir), expected="a run with a books.sqlite", got="none")
        lock = lock_run(run_dir)
        try:
            with damage_named(path):
                connection = connect(path)
                check_file(connection, path)
                store = cls(run_dir, connection, lock)
        except FarmError:
            lock.close()
            raise
        return store

    def close(self) -> None:
        """Close the store and let others open it."""
        self._db.close()
        self._lock.close()

    # ---- writing -------------------------------------------------------------------------------------------------

    def commit(self, batch: Batch) -> None:
        """Make a batch durable: traces first, then everything else in one transaction.

        Raises:
            Unavailable: the disk is full or fails; nothing of the batch counts, and the same batch may be
                committed again later. Nothing may be answered before.
        """
        if not batch:
            return
        assert batch.first_line == self._lines or not batch.lines, "a batch was left out or committed twice"
        self.traces.write(batch.traces)
        self.traces.flush(batch.flushed)
        chain, event_chain = self._chain, self._event_chain
        lines: list[tuple[Value, ...]] = []
        events: list[tuple[Value, ...]] = []
        for number, line in enumerate(batch.lines, self._lines + 1):
            chain = zlib.crc32(line, chain)
            lines.append((number, chain, line))
        for event in batch.events:
            data = wire.encode(event)
            event_chain = zlib.crc32(data, event_chain)
            events.append((event.seq, kind_of(event.fact), event.at_unix_s, event_chain, data))
        self._write(batch, lines, events)
        self._chain, self._event_chain = chain, event_chain
        self._lines += len(lines)
        self._seq += len(events)
        self.traces.drop(batch.dropped)

    def _write(self, batch: Batch, lines: list[tuple[Value, ...]], events: list[tuple[Value, ...]]) -> None:
        rows: dict[str, list[tuple[Value, ...]]] = {}
        for row in batch.rows:
            rows.setdefault(row.table, []).append(row.values)
        try:
            with transaction(self._db):
                self._db.executemany("INSERT INTO journal VALUES (?, ?, ?)", lines)
                self._db.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?)", events)
                for table, values in rows.items():
                    self._db.executemany(INSERT[table], values)
        except sqlite3.OperationalError as fault:
            raise Unavailable(f"{self._path} takes no writes: {fault}") from fault

    # ---- reading -------------------------------------------------------------------------------------------------

    def rebuild(self) -> Books:
        """Return the books as last committed, rebuilt from the journal; `Books.begin` then opens them.

        Raises:
            Refused: a line of the journal is damaged.
        """
        books = Books(self.campaign, self.template, self.target, run_id=self.run_id, read_model=self)
        for line in self.journal():
            books.replay(line)
        self.traces.keep_only(books.wanted_traces)
        return books

    def journal(self) -> Iterator[bytes]:
        """Yield the journal lines in order, each checked; raises Refused at the first damaged one."""
        with damage_named(self._path):
            rows = self._db.execute("SELECT n, chain, line FROM journal ORDER BY n")
            yield from checked_chain(rows, "journal", self._path)

    def trace(self, trace_digest: str) -> bytes | None:
        """Return a packed trace whose content fits its digest, None if it is missing or damaged."""
        return self.traces.read_checked(trace_digest)

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """Return the outcomes of whole rounds in (after, upto], in order, up to about `limit` of them."""
        found: list[Outcome] = []
        query = "SELECT round, content FROM outcomes WHERE round > ? AND round <= ? ORDER BY round, rank"
        for number, content in self._db.execute(query, (after_round, upto_round)):
            if len(found) >= limit and number != found[-1].round:
                break
            found.append(_OUTCOME.decode(content))
        return tuple(found)

    def events(self, from_seq: int, limit: int) -> tuple[bytes, ...]:
        """Return up to `limit` encoded events from `from_seq` on."""
        query = "SELECT event FROM events WHERE seq >= ? ORDER BY seq LIMIT ?"
        return tuple(row[0] for row in self._db.execute(query, (from_seq, limit)))

    def _meta(self, key: str) -> bytes:
        return meta(self._db, key)

    def _decoded(self, key: str, kind: type[T]) -> T:
        return wire.decode(self._meta(key), kind)

    def _tail(self, table: str, column: str) -> tuple[int, int]:
        row = self._db.execute(f"SELECT {column}, chain FROM {table} ORDER BY {column} DESC LIMIT 1").fetchone()  # noqa: S608
        return (0, 0) if row is None else (int(row[0]), int(row[1]))
