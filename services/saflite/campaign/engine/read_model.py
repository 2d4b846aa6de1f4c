"""What the books read of what was committed: blobs that are there, outcomes, events. The store implements it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from saflite.contract.blobs import BlobRef
from saflite.contract.work import Outcome

EVENTS_MAX, EVENTS_BYTES_MAX = 1_000, 2**20
"""Of one answer. In JSON, every byte of words escaped, that is still far below what a message may hold."""


def in_one_answer(events: Iterable[bytes]) -> tuple[bytes, ...]:
    """Return the first of the events, as many as go into one answer, one at least: whoever reads on gets past each.

    A single event is some MiB long at most: its words and its names are bounded.
    """
    found: list[bytes] = []
    left_bytes = EVENTS_BYTES_MAX
    for event in events:
        left_bytes -= len(event)
        if found and left_bytes < 0:
            break
        found.append(event)
        if len(found) == EVENTS_MAX:
            break
    return tuple(found)


class ReadModel(Protocol):
    """Reads what was committed."""

    def blob_fault(self, blob: BlobRef, *, deep: bool = False) -> str:
        """Return `missing`, `damaged` or, where all is well, nothing; only `deep` reads and checks every byte."""
        ...

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """Return the outcomes of whole rounds in (after, upto] in order, up to about `limit` of them."""
        ...

    def events(self, from_seq: int) -> tuple[bytes, ...]:
        """Return the encoded events from `from_seq` on that go into one answer; none only where there are none."""
        ...


class NothingToRead:
    """Stands in where books are only replayed."""

    def blob_fault(self, blob: BlobRef, *, deep: bool = False) -> str:
        """See `ReadModel.blob_fault`."""
        return ""

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """See `ReadModel.outcomes`."""
        raise AssertionError("old outcomes are asked for, but there is nothing to read them from")

    def events(self, from_seq: int) -> tuple[bytes, ...]:
        """See `ReadModel.events`."""
        return ()
