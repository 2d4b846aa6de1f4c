"""Why a run was stopped before its end, noted in its folder: the books of a run that is stopped do not hear of it."""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path

from saflite.contract.bounds import told
from saflite.contract.errors import Refused
from saflite.contract.outside import read_text

FILE = "stopped.txt"
CHARS_MAX = 200
FAILED = "failed: "
"""What a note begins with where the run was not stopped by anybody: a part of its farm broke."""

SIGNAL = "signal "
"""What a note begins with where a signal ended the farm; its name follows."""

log = logging.getLogger(__name__)


def note(run_dir: Path, why: str, *, failed: bool = False) -> None:
    """Note why a run was stopped, for this user only; that it cannot be noted is no reason to fail."""
    why = f"{FAILED}{why}" if failed else why
    part = run_dir / f"{FILE}.part"
    try:
        part.unlink(missing_ok=True)
        part.touch(mode=0o600)
        part.write_text(told(why, CHARS_MAX) + "\n", encoding="utf-8")
        part.replace(run_dir / FILE)  # of a link, the link
    except OSError as fault:
        log.warning("%s not written: %s", FILE, fault)


def is_signal(why: str) -> bool:
    """Return whether this note tells of a signal."""
    return why.startswith(SIGNAL)


def forget(run_dir: Path) -> None:
    """Take the note away: the run is taken up again."""
    with suppress(OSError):
        (run_dir / FILE).unlink()


def read(run_dir: Path) -> str:
    """Return why a run was stopped; empty where that is not known."""
    path = run_dir / FILE
    if path.is_symlink():
        return ""
    try:
        return " ".join(read_text(path, FILE).split())[:CHARS_MAX]
    except Refused:
        return ""
