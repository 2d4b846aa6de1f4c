"""Makes every table of a store anew from its journal: a new file beside the old one, then put in its place at once.

Only the journal and the first facts of the run (`meta`) are read of the old file, so whatever else is damaged in it
does not matter. The old file stays untouched until the new one is complete and on disk.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from saflite.campaign.engine.state import Books
from saflite.campaign.storage import snapshot_file
from saflite.campaign.storage.projections import CREATE, Tables
from saflite.campaign.storage.replaying import replay
from saflite.campaign.storage.seal import seal
from saflite.campaign.storage.sqlite import (
    bound,
    damage_named,
    entries,
    lock_run,
    meta,
    no_run,
    run_id_of,
    transaction,
)
from saflite.campaign.storage.store import store_file
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.evidence.files import flush

REPLAY_STEP = 2000
READ = ("meta", "journal", "words")


def rebuild(run_dir: Path) -> int:
    """Make the tables of a run anew; returns how many journal entries they were made of.

    Raises:
        Refused: there is no run, it is in use, or its journal is damaged: then nothing is changed.
        Unavailable: the disk does not take the new file.
    """
    path = store_file(run_dir)
    if not path.is_file():
        raise no_run(run_dir)
    beside = path.with_suffix(".rebuilt")
    with lock_run(run_dir):
        try:
            _remove(beside)
            with damage_named(path), closing(sqlite3.connect(path, isolation_level=None)) as old:
                bound(old, path, READ)
                lines = _write(old, beside, path)
                _fold_in(old, path)
            _put_in_place(beside, path)
            snapshot_file.remove(run_dir)
            seal(run_dir)
        except OSError as fault:
            raise Unavailable(f"{beside} cannot be written: {fault}") from fault
        finally:
            _remove(beside)
    return lines


def _write(old: sqlite3.Connection, beside: Path, path: Path) -> int:
    with closing(sqlite3.connect(beside, isolation_level=None)) as new:
        bound(new, beside)
        # No log beside it: on a full disk what is not folded in is lost with it when this file takes its place.
        new.execute("PRAGMA journal_mode = OFF")
        new.execute("PRAGMA synchronous = FULL")
        return _filled(old, new, path)


def _filled(old: sqlite3.Connection, new: sqlite3.Connection, path: Path) -> int:
    with transaction(new):
        for statement in CREATE:
            new.execute(statement)
        new.executemany("INSERT INTO meta VALUES (?, ?)", old.execute("SELECT key, value FROM meta"))
        return _replay(old, new, path)


def books_of(connection: sqlite3.Connection) -> Books:
    """Return the books of a store before their first journal entry."""
    campaign = wire.decode(meta(connection, "campaign"), Campaign)
    template = wire.decode(meta(connection, "template"), TestCase)
    target = wire.decode(meta(connection, "target"), TargetInfo)
    return Books(campaign, template, target, run_id=run_id_of(connection))


def _replay(old: sqlite3.Connection, new: sqlite3.Connection, path: Path) -> int:
    books = books_of(old)
    tables = Tables(new)
    for number, line in enumerate(entries(old, "journal", path), 1):
        replay(books, line, number, path, announce=True)
        if number % REPLAY_STEP == 0:
            tables.tails = tables.add(books.drain())
    tables.tails = tables.add(books.drain())
    return tables.tails.lines


def _fold_in(old: sqlite3.Connection, path: Path) -> None:
    """Empty the write-ahead log of the old file: beside another file it would damage that one."""
    busy = old.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]
    if busy:
        raise Refused("run folder", where=str(path), expected="one nobody reads just now", got="one being read")


def _put_in_place(beside: Path, path: Path) -> None:
    flush(beside)
    for end in ("-wal", "-shm"):
        Path(f"{path}{end}").unlink(missing_ok=True)
    beside.replace(path)
    flush(path.parent)


def _remove(beside: Path) -> None:
    for end in ("", "-wal", "-shm"):
        Path(f"{beside}{end}").unlink(missing_ok=True)
