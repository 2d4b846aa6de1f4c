"""What the books look up instead of keeping it in memory: traces, old outcomes, old events. The store implements it."""

from __future__ import annotations

from typing import Protocol

from saflite.contract.work import Outcome


class ReadModel(Protocol):
    """Reads what was committed."""

    def trace(self, trace_digest: str) -> bytes | None:
        """Return a packed trace, None if it is not there."""
        ...

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """Return the outcomes of whole rounds in (after, upto] in order, up to about `limit` of them."""
        ...

    def events(self, from_seq: int, limit: int) -> tuple[bytes, ...]:
        """Return up to `limit` encoded events from `from_seq` on."""
        ...
