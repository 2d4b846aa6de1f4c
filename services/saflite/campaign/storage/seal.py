"""Is a store byte for byte as it was when it was closed? Then nothing in it needs to be worked out anew to be believed.

Journal and events carry checksums of their own, the tables made of them do not. `books.seal` holds the SHA-256 of the
whole file; it goes when the store is opened for writing. It is only a short cut: where it is missing, damaged or of
another file, the tables are compared with what comes of the journal before they are believed.
"""

from __future__ import annotations

import hashlib
import logging
import os
from pathlib import Path

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.outside import read_bytes
from saflite.evidence.files import write_whole

log = logging.getLogger(__name__)

HOLES_MAX = 2**28
"""Bytes without any room on the disk; read within a second."""


def seal_file(run_dir: Path) -> Path:
    """Return the seal of a run folder."""
    return run_dir / "books.seal"


def seal(run_dir: Path, digest: bytes = b"") -> None:
    """Seal a store that is closed and has no write-ahead log; where the disk does not take it there is no seal.

    Only one whose tables are known to be whole: it was sealed when it was opened, is new, or was audited. `digest` is
    that of the file as it was when somebody began to look.
    """
    try:
        found = digest or digest_of(run_dir)
        if found:
            write_whole(seal_file(run_dir), found)
    except (OSError, Unavailable) as fault:
        log.warning("the books are not sealed: %s", fault)


def break_seal(run_dir: Path) -> None:
    """Have no seal: the store is opened for writing."""
    seal_file(run_dir).unlink(missing_ok=True)


def is_sealed(run_dir: Path) -> bool:
    """Return whether the store is as it was sealed, with no write-ahead log beside it."""
    try:
        return not has_log(run_dir) and read_bytes(seal_file(run_dir), "seal", 64) == (digest_of(run_dir) or None)
    except (OSError, Refused):
        return False


def was_closed(run_dir: Path) -> bool:
    """Return whether a store was closed, and sealed then; one that was killed is open yet."""
    return os.path.lexists(seal_file(run_dir)) and not has_log(run_dir)


def has_log(run_dir: Path) -> bool:
    """Return whether a write-ahead log holds something of the store."""
    log_file = run_dir / "books.sqlite-wal"
    return log_file.exists() and log_file.stat().st_size > 0


def digest_of(run_dir: Path) -> bytes:
    """Return the digest of the file of a store; raises OSError where it cannot be read.

    Empty for one with more than `HOLES_MAX` of holes: they take no room, so one that others made may have any length,
    and be read for hours. A few are honest: SQLite leaves them for pages it freed before it wrote them, and a copy may
    for pages of zeros.
    """
    with (run_dir / "books.sqlite").open("rb") as file:
        if _is_hollow(file.fileno()):
            return b""
        os.lseek(file.fileno(), 0, os.SEEK_SET)
        return hashlib.file_digest(file, "sha256").hexdigest().encode()


def _is_hollow(handle: int) -> bool:
    """Return whether a file has more than `HOLES_MAX` of holes."""
    size = os.fstat(handle).st_size
    at = holes = 0
    while at < size and holes <= HOLES_MAX and (begins := os.lseek(handle, at, os.SEEK_HOLE)) < size:
        try:
            at = os.lseek(handle, begins, os.SEEK_DATA)
        except OSError:  # no data behind it
            return holes + size - begins > HOLES_MAX
        holes += at - begins
    return holes > HOLES_MAX
