"""Joining as a pure state machine: ask to be let in until answered, again whenever the books know the session no more.

The part of `runtime/worker.py` that runs before any work is asked for.
"""

from __future__ import annotations

from saflite.contract.join import Joined

RETRY_FIRST_S, RETRY_MAX_S = 0.1, 2.0
WAIT_MAX_S = 60.0


class Joining:
    """Whether a worker is in, and when to ask next."""

    def __init__(self, now_s: float) -> None:
        self.session = ""
        self.refused = ""
        self._asking = False
        self._next_s, self._wait_s = now_s, RETRY_FIRST_S

    def due(self, now_s: float) -> bool:
        """Return whether to ask now; it is then taken as asked."""
        if self.session or self._asking or self.refused or now_s < self._next_s:
            return False
        self._asking = True
        return True

    def next_s(self) -> float:
        """Return when to ask next, infinity if not at all."""
        return float("inf") if self.session or self._asking or self.refused else self._next_s

    def answered(self, joined: Joined | None, now_s: float) -> None:
        """Take the answer; None if nobody answered."""
        self._asking = False
        if joined is None:
            self._next_s = now_s + self._wait_s
            self._wait_s = min(2 * self._wait_s, RETRY_MAX_S)
            return
        self._wait_s = RETRY_FIRST_S
        if joined.accepted:
            self.session = joined.session
        elif joined.retry_after_s > 0.0:
            self._next_s = now_s + min(max(joined.retry_after_s, RETRY_FIRST_S), WAIT_MAX_S)
        else:
            self.refused = joined.message or "the books refused without a word"

    def lost(self, now_s: float) -> None:
        """Note that the books do not know this worker: ask anew. Asking once too often does no harm."""
        self.session, self._next_s = "", now_s
