"""Do the books balance? Recounts a run from its journal and compares with what was told and what stands on disk.

Nothing the books themselves counted is trusted: attempts, flights and endings are counted anew from the journal, the
journal is replayed into fresh books, and every fact and table row that comes out is compared with the stored one.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from saflite.campaign.engine.outbox import Row
from saflite.campaign.engine.state import Books
from saflite.campaign.storage.contents import Contents
from saflite.campaign.storage.journal_audit import JournalAudit
from saflite.campaign.storage.own_folder import check_own
from saflite.campaign.storage.projections import CHAINED, KEYS, TABLES
from saflite.campaign.storage.rebuild import books_of
from saflite.campaign.storage.replaying import replay
from saflite.campaign.storage.seal import digest_of, has_log, is_sealed, seal, was_closed
from saflite.campaign.storage.snapshot_file import Kept, kept
from saflite.campaign.storage.sqlite import (
    check_file,
    connect_reading,
    damage_named,
    entries,
    in_use,
)
from saflite.campaign.storage.store import store_file
from saflite.campaign.storage.typed_rows import rows
from saflite.campaign.storage.witness import loss, start_of
from saflite.contract import wire
from saflite.contract.blobs import BlobRef
from saflite.contract.control import NOT_RUNNING
from saflite.contract.errors import Refused
from saflite.contract.events import CampaignChanged, Event, kind_of
from saflite.contract.names import recording_file
from saflite.evidence.files import fault_of
from saflite.evidence.folder import BlobFolder

REPLAY_STEP = 2000


def audit(run_dir: Path, *, quick: bool = False, blobs: bool = True) -> dict[str, Any]:
    """Return the figures of a run; `clean` says whether the books balance, `problems` what does not, in words.

    Every blob the books name is read and its digest checked; `quick` only looks whether it is there in full length,
    without `blobs` nothing is looked for but the books themselves.
    Works on a finished, an interrupted and a running campaign; what is still under way is counted and is no problem.
    One that nobody works on and that is clean is sealed, if it was not.

    Raises:
        Refused: there is no run, or its store cannot be read at all.
    """
    path = store_file(run_dir)
    lost = loss(run_dir)
    digest = b"" if in_use(run_dir) or has_log(run_dir) or is_sealed(run_dir) else digest_of(run_dir)
    connection = connect_reading(path)
    try:
        with damage_named(path):
            check_file(connection, path)
            connection.execute("BEGIN")
            figures = _audit(run_dir, connection, path, quick, blobs)
    finally:
        connection.close()
    problems = [lost, *figures["problems"]] if lost else figures["problems"]
    if digest and not problems:
        seal(run_dir, digest)
    return {**figures, "clean": not problems, "problems": problems}


def told_of(run_dir: Path) -> str:
    """Return what of a run is lost or damaged, in words, before anything else is told of it; empty if nothing is.

    Commits that are gone, entries with a wrong checksum, and tables that are not what comes of the journal. The last
    takes a replay, left out where the store is as it was closed, or somebody works on it.

    Raises:
        Refused: there is no run, or its store cannot be read at all.
    """
    words = loss(run_dir)
    if words:
        return words
    if in_use(run_dir) or is_sealed(run_dir):
        return _chain_fault(run_dir)
    try:
        problems: list[str] = audit(run_dir, quick=True, blobs=False)["problems"]
    except Refused as fault:
        return str(fault)
    return problems[0] if problems else ""


def resume_faults(run_dir: Path) -> list[str]:
    """Return in words what keeps a run that nobody works on from being taken up again.

    Of a store that was altered since it was closed, or has lost commits, an audit says what is wrong. One that is byte
    for byte as it was closed, or was killed, has its structure checked, and what the books will be rebuilt from is
    replayed: the entries of the journal behind the snapshot, up to the one that was witnessed. Damage in older entries
    is told when they are read, in tables by `audit` and before anything is reported of the run.

    Raises:
        Refused: there is no run, its store cannot be read at all, or a link in it leads elsewhere.
    """
    check_own(run_dir)
    lost = loss(run_dir)
    if lost or (was_closed(run_dir) and not is_sealed(run_dir)):
        problems: list[str] = audit(run_dir, quick=True, blobs=False)["problems"]
        return problems
    fault = _fault_behind_snapshot(run_dir)
    return [fault] if fault else []


@contextmanager
def _reading(run_dir: Path) -> Iterator[tuple[sqlite3.Connection, Path]]:
    """Yield a connection to a store that is one; raises Refused where it is damaged, then or while it is read."""
    path = store_file(run_dir)
    with closing(connect_reading(path)) as connection, damage_named(path):
        check_file(connection, path)
        yield connection, path


def _fault_behind_snapshot(run_dir: Path) -> str:
    try:
        with _reading(run_dir) as (connection, path):
            _books_behind(run_dir, connection, path)
    except Refused as fault:
        return str(fault)
    return ""


def _books_behind(run_dir: Path, connection: sqlite3.Connection, path: Path) -> Books:
    """Return the books of a store, from the snapshot on where there is one; raises Refused at a damaged entry."""
    books, snapshot = books_of(connection), kept(run_dir, start_of(connection), connection)
    if snapshot is not None:
        try:
            books.restore(snapshot.state)
        except ValueError:  # no state of books: the whole journal says it, too
            books, snapshot = books_of(connection), None
    behind = snapshot or Kept(0, 0, b"")
    lines = entries(connection, "journal", path, after=behind.line, chain=behind.chain)
    for number, line in enumerate(lines, behind.line + 1):
        replay(books, line, number, path)
    return books


def read_books(run_dir: Path) -> Books:
    """Return the books of a run as they stand. Nothing is written.

    Raises:
        Refused: there is no run, or what is read of it is damaged.
    """
    with _reading(run_dir) as (connection, path):
        return _books_behind(run_dir, connection, path)


def is_over(run_dir: Path) -> bool:
    """Return whether a campaign has ended for good, not by an order to stop; raises Refused as `read_books`."""
    return bool(read_books(run_dir).audit_status()["over"])


def last_change(run_dir: Path) -> CampaignChanged | None:
    """Return how the campaign of a run changed last, None if it never began; raises Refused as `is_over`."""
    with _reading(run_dir) as (connection, _):
        return Contents(connection).last_change()


def _chain_fault(run_dir: Path) -> str:
    """Return the first entry of journal or events that is damaged, in words."""
    try:
        with _reading(run_dir) as (connection, path):
            for table in CHAINED:
                for _ in entries(connection, table, path):
                    pass
    except Refused as fault:
        return str(fault)
    return ""


def _audit(run_dir: Path, connection: sqlite3.Connection, path: Path, quick: bool, blobs: bool) -> dict[str, Any]:
    # The quick one passes over indices, which queries read as they read tables: enough where no byte has changed.
    check = "quick_check" if quick and is_sealed(run_dir) else "integrity_check"
    problems = [f"SQLite: {row[0]}" for row in connection.execute(f"PRAGMA {check}(20)") if row[0] != "ok"]
    counted = JournalAudit()
    replayed = _Replayed(books_of(connection), kept(run_dir, start_of(connection), connection), path)
    try:
        for line in entries(connection, "journal", path):
            replayed.add(line)
            counted.add(line)
        events = list(entries(connection, "events", path))
    except Refused as fault:
        return {"problems": [*problems, str(fault)]}
    replayed.finish()
    told = [wire.decode(data, Event) for data in events]
    problems += counted.problems + counted.compare_told([event.fact for event in told])
    problems += replayed.compare(events, connection) + replayed.problems
    columns = connection.execute("SELECT kind, at_unix_s FROM events ORDER BY seq")
    wrong = [
        event.seq for event, row in zip(told, columns, strict=True) if (kind_of(event.fact), event.at_unix_s) != row
    ]
    problems += [f"event {seq} stands under another kind or time" for seq in wrong[:20]]
    core = replayed.books.audit_status()
    if core["over"]:
        problems += counted.left_open()
    running = in_use(run_dir)
    beside: dict[str, int] = {}
    if blobs:
        beside |= _blobs(run_dir, replayed.books, problems, running=running, deep=not quick)
        beside |= _recordings(run_dir, connection, problems, running=running, deep=not quick)
    if counted.charged > core["budget"]:
        problems.append(f"budget: {counted.charged} flights with a budget of {core['budget']}")
    return {
        "state": core["state"] if running or core["state"] == "ended" else NOT_RUNNING,
        "budget": core["budget"],
        **counted.figures(over=core["over"]),
        "events": len(events),
        "journal_lines": counted.lines,
        **beside,
        "problems": problems,
    }


class _Replayed:
    """Fresh books fed with the journal, and all they say on the way."""

    def __init__(self, books: Books, snapshot: Kept | None, path: Path) -> None:
        self.books, self._snapshot, self._path = books, snapshot, path
        self.problems: list[str] = []
        self._lines = 0
        self._events: list[bytes] = []
        self._rows: dict[str, dict[tuple[object, ...], int]] = {table: {} for table in TABLES}  # hashes of rows

    def add(self, line: bytes) -> None:
        """Replay one line; raises Refused where that cannot be done."""
        self._lines += 1
        replay(self.books, line, self._lines, self._path, announce=True)
        is_kept = self._snapshot is not None and self._snapshot.line == self._lines
        if self._lines % REPLAY_STEP == 0 or is_kept:
            self.finish()
        if is_kept and self._snapshot is not None and self.books.snapshot() != self._snapshot.state:
            self.problems.append(f"books.snapshot is not the state after journal entry {self._lines}; remove it")

    def finish(self) -> None:
        """Take in what the books said since the last time."""
        batch = self.books.drain()
        self._events += [wire.encode(event) for event in batch.events]
        for row in batch.rows:
            self._rows[row.table][_key(row)] = hash(row.values)

    def compare(self, events: list[bytes], connection: sqlite3.Connection) -> list[str]:
        """Return where the stored facts and rows are not those that come of the journal."""
        problems = []
        if len(events) != len(self._events):
            problems.append(f"events: {len(events)} stored, {len(self._events)} come of the journal")
        wrong = [seq for seq, pair in enumerate(zip(events, self._events, strict=False), 1) if pair[0] != pair[1]]
        problems += [f"event {seq} is not the one that comes of the journal" for seq in wrong[:20]]
        for table, made in self._rows.items():
            stored = {_key(Row(table, row)): hash(row) for row in connection.execute(f"SELECT * FROM {table}")}  # noqa: S608
            names = [key for key in {*stored, *made} if stored.get(key) != made.get(key)]
            problems += [
                f"table {table}, row {key}: not what comes of the journal" for key in sorted(names, key=str)[:5]
            ]
        return problems


def _key(row: Row) -> tuple[object, ...]:
    return tuple(row.values[place] for place in KEYS[row.table])


def _blobs(run_dir: Path, books: Books, problems: list[str], *, running: bool, deep: bool) -> dict[str, int]:
    """Check all the books name; while the farm works, what is missing may just have been dropped."""
    folder, wanted = BlobFolder(run_dir), books.wanted_blobs
    faults = {blob.digest: folder.fault(blob, deep=deep) for blob in wanted}
    bad = {name: fault for name, fault in sorted(faults.items()) if fault and not (running and fault == "missing")}
    problems += [f"blob {name[:16]} is {fault}" for name, fault in list(bad.items())[:20]]
    counts = Counter(bad.values())
    orphans = set() if running else set(folder.digests()) - set(faults)
    return {
        "blobs_kept": len(wanted),
        "blobs_kept_bytes": sum(blob.size_bytes for blob in wanted),
        "blobs_missing": counts["missing"],
        "blobs_damaged": counts["damaged"],
        "blobs_orphan": len(orphans),  # left by an interrupted commit, removed when the run is taken up again
    }


def _recordings(
    run_dir: Path, connection: sqlite3.Connection, problems: list[str], *, running: bool, deep: bool
) -> dict[str, int]:
    """Check the names for people that blobs have besides."""
    counts: Counter[str] = Counter()
    query = "SELECT test_case, flight_index, digest, size_bytes FROM recordings WHERE digest <> '' ORDER BY 1, 2"
    try:
        found = rows(connection, tuple[str, int, str, int], query)
    except Refused as refused:
        problems.append(str(refused))
        found = []
    for test_case, index, digest, size_bytes in found:
        try:
            file = recording_file(test_case, index)
        except Refused as refused:
            problems.append(str(refused))
            continue
        fault = fault_of(run_dir / file, BlobRef(digest=digest, size_bytes=size_bytes), deep=deep)
        fault = "" if running and fault == "missing" else fault  # it gets its name after the commit
        counts[fault] += 1
        if fault:
            problems.append(f"recording {file} is {fault}")
    return {
        "recordings": counts[""],
        "recordings_missing": counts["missing"],
        "recordings_damaged": counts["damaged"],
    }
