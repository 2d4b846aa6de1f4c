"""Is a store byte for byte as it was when it was closed? Then nothing in it needs to be worked out anew to be believed.

Journal and events carry checksums of their own, the tables made of them do not. `books.seal` holds the SHA-256 of the
whole file. It is only a short cut: where it is missing, damaged or of another file, the tables are compared with what
comes of the journal.
"""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.outside import read_bytes
from saflite.evidence.files import write_whole

log = logging.getLogger(__name__)


def seal_file(run_dir: Path) -> Path:
    """Return the seal of a run folder."""
    return run_dir / "books.seal"


def seal(run_dir: Path) -> None:
    """Seal a store that is closed and has no write-ahead log; where the disk does not take it there is no seal."""
    try:
        write_whole(seal_file(run_dir), _digest(run_dir))
    except (OSError, Unavailable) as fault:
        log.warning("the books are not sealed: %s", fault)


def is_sealed(run_dir: Path) -> bool:
    """Return whether the store is as it was sealed, with no write-ahead log beside it."""
    log_file = run_dir / "books.sqlite-wal"
    try:
        if log_file.exists() and log_file.stat().st_size:
            return False
        return read_bytes(seal_file(run_dir), "seal", 64) == _digest(run_dir)
    except (OSError, Refused):
        return False


def _digest(run_dir: Path) -> bytes:
    with (run_dir / "books.sqlite").open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest().encode()
