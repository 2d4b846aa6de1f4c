"""SQLite underneath the store: opening it safely, telling damage from a full disk, running checksums, the lock."""

from __future__ import annotations

import difflib
import errno
import fcntl
import logging
import os
import re
import secrets
import sqlite3
import stat
import zlib
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from saflite.campaign.storage.own_folder import check_own, check_store, check_writable
from saflite.campaign.storage.packing import BYTES_MAX, FIX, Packing
from saflite.campaign.storage.projections import CHAINED, CREATE, FORMAT
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase

BOOKS = "books.sqlite"

log = logging.getLogger(__name__)

_NOT_TO_BE_HAD = (
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_CANTOPEN,
    sqlite3.SQLITE_IOERR,
)


READERS_S = 2.0  # so long a store that is closed waits for who reads it just now
VALUE_BYTES_MAX = 2 * BYTES_MAX
MADE_BY: dict[str, str] = {statement.split()[2]: statement for statement in CREATE}
"""How each table is made, by name."""

FIRST_FACTS = ("format", "run_id", "campaign", "template", "target")
"""What of `meta` never changes."""

_RUN_ID = re.compile(rb"[0-9a-f]{12}")


def connect(path: Path) -> sqlite3.Connection:
    """Open a store for writing: write-ahead log, every commit flushed to disk."""
    connection = sqlite3.connect(path, isolation_level=None, timeout=5.0, check_same_thread=False)
    try:
        bound(connection, path)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA cache_size = -8192")
    except BaseException:
        connection.close()
        raise
    return connection


def no_run(run_dir: Path) -> Refused:
    """Return what to raise where a folder holds no run; a run beside it with nearly that name is asked back."""
    beside = sorted(str(path.parent) for path in run_dir.parent.glob(f"*/{BOOKS}"))
    near = difflib.get_close_matches(str(run_dir), beside, 1)
    fix = f"did you mean {near[0]}?" if near else ""
    return Refused("run folder", where=str(run_dir), expected=f"a run with a {BOOKS}", got="none", fix=fix)


def connect_reading(path: Path) -> sqlite3.Connection:
    """Open a store for reading beside whoever writes it; raises Refused if there is none or it cannot be read."""
    if not path.is_file():
        raise no_run(path.parent)
    real = Path(os.path.realpath(path))
    check_store(real)
    with damage_named(path):
        try:
            return _reading(path, real)
        except sqlite3.OperationalError as fault:
            if fault.sqlite_errorcode != sqlite3.SQLITE_READONLY_ROLLBACK:
                raise
        check_own(path.parent)
        _roll_back(real)
        return _reading(path, real)


def _reading(path: Path, real: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(f"{real.as_uri()}?mode=ro", uri=True, timeout=5.0)
    try:
        bound(connection, path)
        connection.execute("SELECT 1 FROM meta").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection


def _roll_back(path: Path) -> None:
    """Take back what a process that died, or its disk, left half done as it was making one file of a store, or a log.

    Only who may write can, and until then nobody can read.
    """
    connection = sqlite3.connect(path, isolation_level=None, timeout=5.0)
    try:
        connection.execute("SELECT 1 FROM sqlite_schema").fetchone()
    finally:
        connection.close()


def bound(connection: sqlite3.Connection, path: Path, tables: Container[str] = MADE_BY) -> None:
    """Let nothing in a store act: it holds tables as we make them, no views, triggers or indices of others.

    A run may come from somebody else. A view that never ends would be read for ever, a trigger would change what is
    written. Values larger than any of ours are not read. With `tables` only what bears their names is looked at.

    Raises:
        Refused: something else is in it, or it is of another version.
        sqlite3.DatabaseError: it is damaged.
    """
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, VALUE_BYTES_MAX)
    connection.execute("PRAGMA trusted_schema = OFF")
    schema = connection.execute(
        "SELECT type, name, tbl_name, sql FROM sqlite_schema ORDER BY name <> 'meta'"
    ).fetchall()
    for kind, name, table, made_by in schema:
        if (kind == "table" and MADE_BY.get(name) == made_by) or (kind == "index" and made_by is None):
            if name == "meta":
                check_version(connection, path)
        elif tables is MADE_BY or name in tables or table in tables:
            got = f"{kind} {name!r}, which is none of ours or made otherwise"
            raise Refused("books", where=str(path), expected="the tables of a store and nothing else", got=got, fix=FIX)


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
    """Leave a store that nobody works on as one file, without a write-ahead log.

    Where somebody has it open the log stays, empty: the file is whole all the same, and can be sealed. Only who reads
    just now, and for longer than `READERS_S`, keeps something in the log.
    """
    connection = sqlite3.connect(path, isolation_level=None, timeout=READERS_S)
    try:
        connection.execute("PRAGMA synchronous = FULL")
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.execute("PRAGMA journal_mode = DELETE")
    except sqlite3.OperationalError as fault:
        log.info("%s is open elsewhere, its write-ahead log stays: %s", path, fault)
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
    key = CHAINED[table][0]
    row = connection.execute(f"SELECT chain FROM {table} WHERE {key} = ?", (number,)).fetchone()  # noqa: S608
    return 0 if not number else -1 if row is None or not isinstance(row[0], int) else row[0]


def check_version(connection: sqlite3.Connection, path: Path) -> None:
    """Raise Refused unless the file is a store of this version."""
    row = connection.execute("SELECT value FROM meta WHERE key = 'format'").fetchone()
    version = "none" if row is None else _text(row[0])
    if version != str(FORMAT):
        fix = "the version of saflite that wrote the run reads it (software.json in its folder names it)"
        raise Refused("books", where=str(path), expected=f"store format {FORMAT}", got=f"format {version}", fix=fix)


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


def run_id_of(connection: sqlite3.Connection) -> str:
    """Return by what the leases of a run are told from others'; raises Refused where that is none of ours."""
    name, fix = meta(connection, "run_id"), "restore the run folder from a copy"
    if _RUN_ID.fullmatch(name) is None:
        raise Refused("books", where="run_id", expected="12 hexadecimal digits", got=repr(name[:40]), fix=fix)
    return name.decode()


def check_free(run_dir: Path) -> None:
    """Raise InUse if some process works on a run; writes nothing, and keeps nobody from it."""
    if in_use(run_dir):
        raise _used(run_dir)


def _used(run_dir: Path) -> InUse:
    return InUse("run folder", where=str(run_dir), expected="one not in use", got="one another process works on")


def in_use(run_dir: Path) -> bool:
    """Return whether some process works on a run."""
    try:
        with _lock_file(run_dir, os.O_RDONLY) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError as fault:
        return fault.errno != errno.ELOOP  # a link: refused by whoever would write
    return False


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def entries(
    connection: sqlite3.Connection,
    table: str,
    path: Path,
    *,
    after: int = 0,
    chain: int = 0,
    limit: int = -1,
    packing: Packing | None = None,
) -> Iterator[bytes]:
    """Yield the contents of a chained table's entries after one, at most `limit` of them, each checked.

    Args:
        connection: an open store.
        table: `journal` or `events`.
        path: the store's file, for what is said of damage.
        after: the number of the entry they come after.
        chain: the running checksum of that one.
        limit: -1 for all.
        packing: of this table, where many entries are read one by one: it keeps the words they are told in.

    Raises:
        Refused: there is a gap, a wrong checksum, or what cannot be unpacked.
    """
    key, content = CHAINED[table]
    query = f"SELECT {key}, chain, {content} FROM {table} WHERE {key} > ? ORDER BY {key} LIMIT ?"  # noqa: S608
    packing = packing or Packing(connection, table)
    for expected, (number, stored, packed) in enumerate(connection.execute(query, (after, limit)), after + 1):
        entry = packing.unpack(expected, packed) if number == expected else b""
        chain = zlib.crc32(entry, chain)
        if number != expected or chain != stored:
            where = f"{path}, {table} entry {expected}"
            got = f"entry {number}" if number != expected else "a wrong checksum"
            raise Refused("books", where=where, expected="an unbroken journal", got=got, fix=FIX)
        yield entry


def _lock_file(run_dir: Path, flags: int) -> IO[bytes]:
    """Open the file that is locked, without waiting for anybody; raises Refused where something else stands there."""
    path = run_dir / "books.lock"
    handle = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOFOLLOW, 0o644)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise Refused("books.lock", where=str(run_dir), expected="a regular file", got="a folder, device or pipe")
    return os.fdopen(handle, "rb" if flags == os.O_RDONLY else "rb+")


class InUse(Refused):
    """Another process has the run folder open; one just killed may hold it for a moment longer."""


def lock_run(run_dir: Path) -> IO[bytes]:
    """Lock a run folder for this process until the file is closed, before anything is written into it.

    Raises:
        InUse: another process has it.
        Refused: a link in it leads elsewhere, or the lock is no file.
        Unavailable: something in it cannot be written.
    """
    check_own(run_dir)
    file = _lock_file(run_dir, os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as fault:
        file.close()
        raise _used(run_dir) from fault
    try:
        check_writable(run_dir)
    except Unavailable:
        file.close()
        raise
    file.truncate(0)
    file.write(str(os.getpid()).encode())
    file.flush()
    return file
