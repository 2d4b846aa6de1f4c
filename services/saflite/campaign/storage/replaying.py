"""Replays the journal of a run. A line that fits its checksums and cannot be replayed is damage, and told as such."""

from __future__ import annotations

from pathlib import Path

from saflite.campaign.engine.state import Books
from saflite.contract import wire
from saflite.contract.errors import Refused

FAULTS = (
    *(AssertionError, LookupError, ValueError, TypeError, AttributeError, ArithmeticError),
    *wire.UNREADABLE,
)
"""What the fold raises for a line that does not follow from those before it, or is none of this version."""

FIX = "restore the run folder from a copy, or use the version of saflite that wrote the run"
WORDS_MAX = 300


def replay(books: Books, line: bytes, number: int, path: Path, *, announce: bool = False) -> None:
    """Replay the journal line of this number in the store at `path`; raises Refused where that cannot be done."""
    try:
        books.replay(line, announce=announce)
    except FAULTS as fault:
        words = " ".join(f"{type(fault).__name__}: {fault}".split())[:WORDS_MAX]
        where = f"{path}, journal entry {number}"
        raise Refused("books", where=where, expected="an entry that can be replayed", got=words, fix=FIX) from fault
