"""A witness beside the store of how far the books had got, so that lost commits are noticed when the books are opened.

SQLite itself cannot tell: of a write-ahead log that is damaged or missing it takes what is intact and says nothing.
After each commit, and before anything is answered, `books.witness` gets a record: which commit it was, how many
journal lines and events there are, and the running checksum of each. Records are chained by SHA-256, the first to the
facts of the run (campaign, template, target, run id). Now and then, and at the end, one record takes the place of all.

A crash leaves the store at most one commit ahead of its witness. A store behind it has lost commits.
"""

from __future__ import annotations

import hashlib
import os
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from saflite.campaign.storage.projections import tail
from saflite.campaign.storage.snapshot_file import lines_of
from saflite.campaign.storage.snapshot_file import remove as remove_snapshot
from saflite.campaign.storage.sqlite import (
    FIRST_FACTS,
    check_version,
    connect_reading,
    damage_named,
    in_use,
    lock_run,
    meta,
)
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.outside import read_bytes
from saflite.evidence.files import flush

_FIELDS = struct.Struct(">QQIQI")
_CHECK_BYTES = hashlib.sha256().digest_size
BYTES_MAX = 64 * 2**20
RECORD_BYTES = _FIELDS.size + _CHECK_BYTES
COMMITS_DIGITS_MAX = 18
FIX = (
    "restore the whole run folder from a copy (books.sqlite, books.sqlite-wal and books.witness together);"
    " or `saflite resume RUN --accept-loss` goes on with what is left"
)


class Mark(NamedTuple):
    """How far the books had got: commits, entries of the two chained tables and their running checksums."""

    commits: int
    lines: int
    chain: int
    events: int
    event_chain: int


class Witness:
    """The witness of one run, open for writing; the caller holds the lock of the run."""

    def __init__(self, run_dir: Path, start: bytes, mark: Mark) -> None:
        """Begin anew with one record that says `mark`; raises Unavailable if the disk fails."""
        self._path, self._start = witness_file(run_dir), start
        self._file, self._check, self._size = -1, start, 0
        self.restart(mark)

    def append(self, mark: Mark) -> None:
        """Have a further record on disk; raises Unavailable if the disk fails, the same may be appended again then."""
        record, check = _record(mark, self._check)
        try:
            if os.pwrite(self._file, record, self._size) != len(record):
                raise OSError("a part of the record only")
            os.fdatasync(self._file)
        except OSError as fault:
            raise Unavailable(f"{self._path} takes no writes: {fault}") from fault
        self._check, self._size = check, self._size + len(record)

    def restart(self, mark: Mark) -> None:
        """Put one record in place of all; raises Unavailable if the disk fails: then all stays as it was."""
        record, check = _record(mark, self._start)
        beside = self._path.with_suffix(".witness.part")
        try:
            file = os.open(beside, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o644)
            try:
                if os.write(file, record) != len(record):
                    raise OSError("a part of the record only")
                os.fsync(file)
                beside.replace(self._path)
            except OSError:
                os.close(file)
                beside.unlink(missing_ok=True)
                raise
            self.close()
            self._file, self._check, self._size = file, check, len(record)
            flush(self._path.parent)
        except OSError as fault:
            raise Unavailable(f"{self._path} takes no writes: {fault}") from fault

    def close(self) -> None:
        """Let go of the file."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def witness_file(run_dir: Path) -> Path:
    """Return the witness of a run folder."""
    return run_dir / "books.witness"


def start_of(connection: sqlite3.Connection) -> bytes:
    """Return what the first record is chained to: a digest of the first facts of the run."""
    facts = [meta(connection, key) for key in FIRST_FACTS]
    return hashlib.sha256(b"".join(len(fact).to_bytes(8) + fact for fact in facts)).digest()


def mark_of(connection: sqlite3.Connection) -> Mark:
    """Return how far a store says that it has got; one whose count of commits is none has none."""
    commits = meta(connection, "commits")
    lines, events = (tail(connection, table) for table in ("journal", "events"))
    return Mark(int(commits) if commits.isdigit() and len(commits) <= COMMITS_DIGITS_MAX else 0, *lines, *events)


def loss(run_dir: Path) -> str:
    """Return what of a run is lost or damaged by its witness, in words; empty if nothing is.

    The witness is read before the store, so both may grow meanwhile.

    Raises:
        Refused: there is no run, or its store cannot be read at all.
    """
    running = in_use(run_dir)
    path = run_dir / "books.sqlite"
    said = _read(run_dir)
    connection = connect_reading(path)
    try:
        with damage_named(path):
            check_version(connection, path)
            return _compare(said, connection, running=running) or _rolled_back(run_dir, connection)
    finally:
        connection.close()


def check_loss(run_dir: Path) -> None:
    """Raise Refused if commits of a run that nobody works on are lost."""
    words = loss(run_dir)
    if words:
        raise Refused(
            "books", where=str(run_dir / "books.sqlite"), expected="all that was committed", got=words, fix=FIX
        )


def accept_loss(run_dir: Path) -> None:
    """Take what is left of a run for all there is, with a witness begun anew.

    Raises:
        Refused: there is no run, it is in use, or its store cannot be read at all.
        Unavailable: the disk fails.
    """
    path = run_dir / "books.sqlite"
    with lock_run(run_dir), damage_named(path), closing(connect_reading(path)) as connection:
        Witness(run_dir, start_of(connection), mark_of(connection)).close()
        if lines_of(run_dir, start_of(connection)) > mark_of(connection).lines:
            remove_snapshot(run_dir)  # of what is lost


def _read(run_dir: Path) -> bytes:
    path = witness_file(run_dir)
    return read_bytes(path, "books.witness", BYTES_MAX) if os.path.lexists(path) else b""


def _compare(data: bytes, connection: sqlite3.Connection, *, running: bool) -> str:
    if not data:
        return "books.witness is missing or empty, so nothing shows whether commits are lost"
    witnessed, left = _last(data, start_of(connection))
    if witnessed is None:
        return "books.witness is damaged, or belongs to another run"
    if left > RECORD_BYTES:  # a crash tears at most the record it was writing
        return f"books.witness is damaged after commit {witnessed.commits}"
    store = mark_of(connection)
    if store.commits < witnessed.commits:
        return (
            f"{witnessed.commits - store.commits} commits are lost: {store.lines} journal entries and {store.events}"
            f" events are left of {witnessed.lines} and {witnessed.events}"
        )
    if store.commits > witnessed.commits + 1 and not running:
        return f"books.witness ends {store.commits - witnessed.commits} commits before the store does"
    if store.commits == witnessed.commits and store != witnessed:
        return f"the store does not end as it was committed: {store} is not {witnessed}"
    for table, key, number, chain in (
        ("journal", "n", witnessed.lines, witnessed.chain),
        ("events", "seq", witnessed.events, witnessed.event_chain),
    ):
        row = connection.execute(f"SELECT chain FROM {table} WHERE {key} = ?", (number,)).fetchone()  # noqa: S608
        if (row or (0,))[0] != chain:
            return f"{table} entry {number} is not the one that was committed"
    return ""


def _rolled_back(run_dir: Path, connection: sqlite3.Connection) -> str:
    """Tell a store that was put in place of a newer one together with its witness: the snapshot has seen more.

    It is made after a commit, never before.
    """
    seen = lines_of(run_dir, start_of(connection))
    there = mark_of(connection).lines
    if seen <= there:
        return ""
    return f"the store and its witness are older than books.snapshot: {there} journal entries of at least {seen}"


def _last(data: bytes, check: bytes) -> tuple[Mark | None, int]:
    """Return the last record of the unbroken chain from the beginning, and how many bytes come after it."""
    last = None
    for place in range(0, len(data) - RECORD_BYTES + 1, RECORD_BYTES):
        mark = Mark(*_FIELDS.unpack_from(data, place))
        record, check = _record(mark, check)
        if record != data[place : place + RECORD_BYTES]:
            return last, len(data) - place
        last = mark
    return last, len(data) % RECORD_BYTES


def _record(mark: Mark, before: bytes) -> tuple[bytes, bytes]:
    fields = _FIELDS.pack(*mark)
    check = hashlib.sha256(before + fields).digest()
    return fields + check, check
