"""SQLite underneath the store: opening it safely, telling damage from a full disk, running checksums, the lock."""

from __future__ import annotations

import fcntl
import logging
import os
import secrets
import sqlite3
import stat
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from saflite.campaign.storage.projections import CREATE, FORMAT
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase

log = logging.getLogger(__name__)

_NOT_TO_BE_HAD = (
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_IOERR,
)
FIX = "`saflite audit RUN --rebuild` makes all but the journal anew; else restore the run folder from a copy"


FIRST_FACTS = ("format", "run_id", "campaign", "template", "target")
"""What of `meta` never changes."""


def connect(path: Path) -> sqlite3.Connection:
    """Open a store for writing: write-ahead log, every commit flushed to disk."""
    connection = sqlite3.connect(path, isolation_level=None, timeout=5.0, check_same_thread=False)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA cache_size = -8192")
    return connection


def connect_reading(path: Path) -> sqlite3.Connection:
    """Open a store for reading beside whoever writes it; raises Refused if there is none or it cannot be read."""
    if not path.is_file():
        raise Refused("run folder", where=str(path.parent), expected="a run with a books.sqlite", got="none")
    with damage_named(path):
        connection = sqlite3.connect(f"{Path(os.path.realpath(path)).as_uri()}?mode=ro", uri=True, timeout=5.0)
        connection.execute("SELECT 1 FROM meta").fetchone()
    return connection


def fold_in(connection: sqlite3.Connection) -> None:
    """Fold the write-ahead log into the file, unless somebody reads just now: then the next time does it.

    The log keeps its length: written over, not appended to, it costs the disk half as much at each commit.
    """
    connection.execute("PRAGMA busy_timeout = 0")
    try:
        connection.execute("PRAGMA wal_checkpoint(RESTART)")
    finally:
        connection.execute("PRAGMA busy_timeout = 5000")


def make_one_file(path: Path) -> None:
    """Leave a store that nobody works on as one file, without a write-ahead log; not while somebody reads it."""
    connection = sqlite3.connect(path, isolation_level=None, timeout=0.0)
    try:
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA journal_mode = DELETE")
    except sqlite3.OperationalError as fault:
        log.info("%s keeps its write-ahead log: %s", path, fault)
    finally:
        connection.close()


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Commit what is done inside, or nothing of it."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


def make_tables(connection: sqlite3.Connection, campaign: Campaign, template: TestCase, target: TargetInfo) -> None:
    """Write the tables and the first facts of a new run, in one transaction."""
    facts = (
        ("format", str(FORMAT).encode()),
        ("run_id", secrets.token_hex(6).encode()),
        ("campaign", wire.encode(campaign)),
        ("template", wire.encode(template)),
        ("target", wire.encode(target)),
        ("commits", b"0"),
    )
    with transaction(connection):
        for statement in CREATE:
            connection.execute(statement)
        connection.executemany("INSERT INTO meta VALUES (?, ?)", facts)


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Turn what SQLite says of a file into one line for the user: damaged is Refused, not to be had is Unavailable."""
    try:
        yield
    except sqlite3.DatabaseError as fault:
        code = getattr(fault, "sqlite_errorcode", 0)
        if code & 0xFF in _NOT_TO_BE_HAD and code != sqlite3.SQLITE_IOERR_SHORT_READ:
            raise Unavailable(f"{path}: {fault}") from fault
        raise Refused("books", where=str(path), expected="an intact store", got=str(fault), fix=FIX) from fault


def chain_at(connection: sqlite3.Connection, table: str, number: int) -> int:
    """Return the running checksum that an entry of a chained table bears; 0 before the first, -1 where it is gone."""
    key = {"journal": "n", "events": "seq"}[table]
    row = connection.execute(f"SELECT chain FROM {table} WHERE {key} = ?", (number,)).fetchone()  # noqa: S608
    return 0 if not number else -1 if row is None or not isinstance(row[0], int) else row[0]


def check_version(connection: sqlite3.Connection, path: Path) -> None:
    """Raise Refused unless the file is a store of this version."""
    row = connection.execute("SELECT value FROM meta WHERE key = 'format'").fetchone()
    version = "none" if row is None else _text(row[0])
    if version != str(FORMAT):
        raise Refused("books", where=str(path), expected=f"store format {FORMAT}", got=f"format {version}")


def check_file(connection: sqlite3.Connection, path: Path) -> None:
    """Raise Refused unless the file is a whole store of this version."""
    check_version(connection, path)
    said = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
    if said != "ok":
        raise Refused("books", where=str(path), expected="an intact store", got=said, fix=FIX)


def meta(connection: sqlite3.Connection, key: str) -> bytes:
    """Return one of the first facts of a run, empty if it is not there."""
    row = connection.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
    return bytes(row[0]) if row is not None and isinstance(row[0], bytes) else b""


def in_use(run_dir: Path) -> bool:
    """Return whether some process works on a run."""
    try:
        with _lock_file(run_dir, os.O_RDONLY) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def checked_chain(
    rows: Iterable[tuple[int, int, bytes]], table: str, path: Path, *, after: int = 0, chain: int = 0
) -> Iterator[bytes]:
    """Yield the contents of (number, checksum, content) rows; raises Refused at a gap or a wrong checksum.

    The rows are those `after` an entry, whose running checksum is `chain`.
    """
    for expected, (number, stored, content) in enumerate(rows, after + 1):
        chain = zlib.crc32(content, chain) if isinstance(content, bytes) else -1
        if number != expected or chain != stored:
            what = f"{table} entry {expected}"
            got = f"entry {number}" if number != expected else "a wrong checksum"
            raise Refused("books", where=f"{path}, {what}", expected="an unbroken journal", got=got, fix=FIX)
        yield content


def journal_after(connection: sqlite3.Connection, path: Path, after: int = 0, chain: int = 0) -> Iterator[bytes]:
    """Yield the journal lines after one with the running checksum `chain`; raises Refused at a damaged one."""
    rows = connection.execute("SELECT n, chain, line FROM journal WHERE n > ? ORDER BY n", (after,))
    return checked_chain(rows, "journal", path, after=after, chain=chain)


def _lock_file(run_dir: Path, flags: int) -> IO[bytes]:
    """Open the file that is locked, without waiting for anybody; raises Refused where something else stands there."""
    path = run_dir / "books.lock"
    handle = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o644)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise Refused("books.lock", where=str(run_dir), expected="a regular file", got="a folder, device or pipe")
    return os.fdopen(handle, "rb" if flags == os.O_RDONLY else "rb+")


class InUse(Refused):
    """Another process has the run folder open; one just killed may hold it for a moment longer."""


def lock_run(run_dir: Path) -> IO[bytes]:
    """Lock a run folder for this process until the file is closed; raises InUse if another process has it."""
    file = _lock_file(run_dir, os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as fault:
        file.close()
        raise InUse(
            "run folder", where=str(run_dir), expected="one not in use", got="one another process works on"
        ) from fault
    file.truncate(0)
    file.write(str(os.getpid()).encode())
    file.flush()
    return file
