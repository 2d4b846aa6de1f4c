"""The state of the books beside their journal, `books.snapshot`: a cache, so that a long run is taken up again soon.

It names the run, the journal entry it stands behind with that entry's running checksum, and the code it was made by;
whatever does not fit, or is damaged, is not used, and the journal is replayed from its beginning instead. An audit
compares it with the state that comes of the journal. A state may say anything, and contradict itself where a journal
could not: nobody goes on from one that this user's farms have not made (`evidence/own_runs.py`).
"""

from __future__ import annotations

import hashlib
import logging
import os
import sqlite3
import struct
import sys
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from saflite.campaign.storage.sqlite import chain_at
from saflite.contract.errors import Refused
from saflite.contract.outside import read_bytes
from saflite.evidence import own_runs

log = logging.getLogger(__name__)

BYTES_MAX = 2**28  # ten times what 100,000 flights take; beside a larger one the journal is read
LINES_MAX = 8_000  # so many journal entries later the next one is due: replayed in two seconds at most
_HEAD = struct.Struct(">32s32sQI")
_CHECK_BYTES = hashlib.sha256().digest_size
_CODE = (
    *("contract", "campaign/engine", "campaign/lifecycle", "campaign/scheduling"),
    *("flight/novelty.py", "flight/track_shape.py", "flight/competition", "flight/mission.py"),
    *("flight/native_library.py", "flight/native_sources.py", "flight/mending.py"),
    *("flight/native/alignment.c", "flight/native/alignment.h"),
)


class Kept(NamedTuple):
    """A state of the books, the number of the last journal entry in it, and the running checksum of that entry."""

    line: int
    chain: int
    state: bytes


def snapshot_file(run_dir: Path) -> Path:
    """Return the snapshot of a run folder."""
    return run_dir / "books.snapshot"


def keep(run_dir: Path, start: bytes, line: int, chain: int, state: bytes) -> None:
    """Write a snapshot in place of the last one. Where the disk does not take it there is none: it is only a cache."""
    path = snapshot_file(run_dir)
    beside = path.with_suffix(".snapshot.part")
    head = _HEAD.pack(code(), start, line, chain)
    try:
        with beside.open("wb") as file:
            packed = zlib.compress(state, 1)
            check = _check(head, packed)
            file.writelines((head, packed, own_runs.signed(check), check))
        os.replace(beside, path)
    except OSError as fault:
        log.warning("no snapshot of the books is kept: %s", fault)
        with suppress(OSError):
            beside.unlink(missing_ok=True)


def lines_of(run_dir: Path, start: bytes) -> int:
    """Return how many journal entries there were when the snapshot was made, 0 where none of this run is whole."""
    if not os.path.lexists(snapshot_file(run_dir)):
        return 0
    try:
        _, run, line, *_ = _read(run_dir)
    except Refused:
        return 0
    return line if run == start else 0


def kept(run_dir: Path, start: bytes, connection: sqlite3.Connection, *, ours: bool = False) -> Kept | None:
    """Return the snapshot if it is whole, of this run, of this code, and stands behind an entry of this journal.

    `ours`: and made by a farm of this user.
    """
    if not os.path.lexists(snapshot_file(run_dir)):
        return None
    try:
        made_by, run, line, chain, packed, is_ours = _read(run_dir)
    except Refused as fault:
        log.warning("the snapshot is not used: %s", fault)
        return None
    for fits, other in (
        (run == start, "another run"),
        (made_by == code(), "other code than this"),
        (is_ours or not ours, "another user"),
        (chain_at(connection, "journal", line) == chain, "another journal"),
    ):
        if not fits:
            log.warning("%s is of %s and not used: the whole journal is read", snapshot_file(run_dir), other)
            return None
    unpacker = zlib.decompressobj()
    try:
        state = unpacker.decompress(packed, BYTES_MAX)
    except zlib.error as fault:
        log.warning("%s is not used: %s", snapshot_file(run_dir), fault)
        return None
    if not unpacker.eof:
        log.warning("%s unpacks to more than %d bytes and is not used", snapshot_file(run_dir), BYTES_MAX)
        return None
    return Kept(line, chain, state)


def _read(run_dir: Path) -> tuple[bytes, bytes, int, int, bytes, bool]:
    """Return what stands in a snapshot's head, its state, packed, and whether it is this user's.

    Raises:
        Refused: it is damaged.
    """
    path = snapshot_file(run_dir)
    data = read_bytes(path, "snapshot", BYTES_MAX)
    head, body, check = data[: _HEAD.size], data[_HEAD.size : -_CHECK_BYTES], data[-_CHECK_BYTES:]
    packed, mark = body[: -own_runs.SIGNED_BYTES], body[-own_runs.SIGNED_BYTES :]
    if len(head) < _HEAD.size or check != _check(head, packed):
        raise Refused("snapshot", where=str(path), expected="one that fits its checksum", got="a damaged one")
    return (*_HEAD.unpack(head), packed, own_runs.is_signed(mark, check))


def remove(run_dir: Path) -> None:
    """Have no snapshot."""
    snapshot_file(run_dir).unlink(missing_ok=True)


def _check(head: bytes, packed: bytes) -> bytes:
    found = hashlib.sha256(head)
    found.update(packed)
    return found.digest()


def code_files() -> list[Path]:
    """Return the files of the code that makes the state of the journal."""
    package = Path(__file__).resolve().parents[2]
    places = [package / place for place in _CODE]
    return [path for place in places for path in (sorted(place.rglob("*.py")) if place.is_dir() else [place])]


@cache
def code() -> bytes:
    """Return the digest of the code that makes the state of the journal, as it was when first asked for.

    Ask for it when the books are opened: what is on disk when they close may have changed meanwhile, and did not run.
    """
    package = Path(__file__).resolve().parents[2]
    found = hashlib.sha256(f"{np.__version__} {sys.version}".encode())
    for path in code_files():
        found.update(path.relative_to(package).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return found.digest()
