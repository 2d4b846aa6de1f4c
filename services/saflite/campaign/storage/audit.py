"""Do the books balance? Recounts a run from its journal and compares with what was told and what stands on disk.

Nothing the books themselves counted is trusted: attempts, flights and endings are counted anew from the journal, the
journal is replayed into fresh books, and every fact and table row that comes out is compared with the stored one.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from pathlib import Path
from typing import Any

from saflite.campaign.engine.outbox import Row
from saflite.campaign.engine.state import Books
from saflite.campaign.storage.blobs import TraceFiles
from saflite.campaign.storage.journal_audit import Recount
from saflite.campaign.storage.projections import KEYS, TABLES
from saflite.campaign.storage.sqlite import check_file, checked_chain, connect_reading, damage_named, in_use, meta
from saflite.campaign.storage.store import TRACES, store_file
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused
from saflite.contract.events import Event
from saflite.contract.ids import digest
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase

REPLAY_STEP = 2000


def audit(run_dir: Path) -> dict[str, Any]:
    """Return the figures of a run; `clean` says whether the books balance, `problems` what does not, in words.

    Works on a finished, an interrupted and a running campaign; what is still under way is counted and is no problem.

    Raises:
        Refused: there is no run, or its store cannot be read at all.
    """
    path = store_file(run_dir)
    connection = connect_reading(path)
    try:
        with damage_named(path):
            check_file(connection, path)
            connection.execute("BEGIN")
            return _audit(run_dir, connection, path)
    finally:
        connection.close()


def _audit(run_dir: Path, connection: sqlite3.Connection, path: Path) -> dict[str, Any]:
    problems = [f"SQLite: {row[0]}" for row in connection.execute("PRAGMA integrity_check(20)") if row[0] != "ok"]
    recount = Recount()
    replayed = _Replayed(_books(connection))
    try:
        for line in checked_chain(connection.execute("SELECT n, chain, line FROM journal ORDER BY n"), "journal", path):
            recount.add(line)
            replayed.add(line)
        stored = connection.execute("SELECT seq, chain, event FROM events ORDER BY seq")
        events = list(checked_chain(stored, "event", path))
    except Refused as fault:
        return {"clean": False, "problems": [*problems, str(fault)]}
    replayed.finish()
    told = [wire.decode(data, Event) for data in events]
    problems += recount.problems + recount.compare_told([event.fact for event in told])
    problems += replayed.compare(events, connection)
    core = replayed.books.overview_of_audit()
    if core["over"]:
        problems += recount.left_open()
    traces = _traces(run_dir, replayed.books, problems, in_use(run_dir))
    recordings = _recordings(run_dir, connection, problems)
    if recount.charged > core["budget"]:
        problems.append(f"budget: {recount.charged} flights with a budget of {core['budget']}")
    return {
        "clean": not problems,
        "state": core["state"],
        "budget": core["budget"],
        **recount.figures(),
        "events": len(events),
        "journal_lines": recount.lines,
        **traces,
        **recordings,
        "problems": problems,
    }


def _books(connection: sqlite3.Connection) -> Books:
    campaign = wire.decode(meta(connection, "campaign"), Campaign)
    template = wire.decode(meta(connection, "template"), TestCase)
    target = wire.decode(meta(connection, "target"), TargetInfo)
    return Books(campaign, template, target, run_id=meta(connection, "run_id").decode())


class _Replayed:
    """Fresh books fed with the journal, and all they say on the way."""

    def __init__(self, books: Books) -> None:
        self.books = books
        self._lines = 0
        self._events: list[bytes] = []
        self._rows: dict[str, dict[tuple[object, ...], int]] = {table: {} for table in TABLES}  # hashes of rows

    def add(self, line: bytes) -> None:
        """Replay one line."""
        self.books.replay(line, aloud=True)
        self._lines += 1
        if self._lines % REPLAY_STEP == 0:
            self.finish()

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
        for table, rows in self._rows.items():
            stored = {_key(Row(table, row)): hash(row) for row in connection.execute(f"SELECT * FROM {table}")}  # noqa: S608
            names = [key for key in {*stored, *rows} if stored.get(key) != rows.get(key)]
            problems += [
                f"table {table}, row {key}: not what comes of the journal" for key in sorted(names, key=str)[:5]
            ]
        return problems


def _key(row: Row) -> tuple[object, ...]:
    return tuple(row.values[place] for place in KEYS[row.table])


def _traces(run_dir: Path, books: Books, problems: list[str], running: bool) -> dict[str, int]:
    files = TraceFiles(run_dir / TRACES)
    there, wanted = set(files.digests()), set(books.wanted_traces)
    missing = sorted(wanted - there) if not running else []
    damaged = sorted(name for name in wanted & there if files.read_checked(name) is None)
    orphans = sorted(there - wanted) if not running else []
    problems += [f"trace {name[:16]} is missing" for name in missing[:20]]
    problems += [f"trace {name[:16]} is damaged" for name in damaged[:20]]
    return {
        "traces_kept": len(wanted),
        "traces_missing": len(missing),
        "traces_damaged": len(damaged),
        "traces_orphan": len(orphans),  # left by an interrupted commit, removed when the run is taken up again
    }


def _recordings(run_dir: Path, connection: sqlite3.Connection, problems: list[str]) -> dict[str, int]:
    counts: Counter[str] = Counter()
    for file, expected in connection.execute("SELECT file, digest FROM recordings ORDER BY file"):
        path = run_dir / str(file)
        state = "missing" if not path.is_file() else "fine" if digest(path.read_bytes()) == expected else "damaged"
        counts[state] += 1
        if state != "fine":
            problems.append(f"recording {file} is {state}")
    names = ("fine", "missing", "damaged")
    return {f"recordings_{name}" if name != "fine" else "recordings": counts[name] for name in names}
