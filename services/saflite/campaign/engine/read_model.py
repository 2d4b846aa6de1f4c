"""What the books read of what was committed: blobs that are there, outcomes, events. The store implements it."""

from __future__ import annotations

from typing import Protocol

from saflite.contract.blobs import BlobRef
from saflite.contract.work import Outcome


class ReadModel(Protocol):
    """Reads what was committed."""

    def blob_fault(self, blob: BlobRef, *, deep: bool = False) -> str:
        """Return `missing`, `damaged` or, where all is well, nothing; only `deep` reads and checks every byte."""
        ...

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """Return the outcomes of whole rounds in (after, upto] in order, up to about `limit` of them."""
        ...

    def events(self, from_seq: int, limit: int) -> tuple[bytes, ...]:
        """Return up to `limit` encoded events from `from_seq` on."""
        ...


class NothingToRead:
    """Stands in where books are only replayed."""

    def blob_fault(self, blob: BlobRef, *, deep: bool = False) -> str:
        """See `ReadModel.blob_fault`."""
        return ""

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """See `ReadModel.outcomes`."""
        raise AssertionError("old outcomes are asked for, but there is nothing to read them from")

    def events(self, from_seq: int, limit: int) -> tuple[bytes, ...]:
        """See `ReadModel.events`."""
        return ()
