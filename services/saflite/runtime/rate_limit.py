"""How much a key may ask: a token bucket for each name a certificate proves; the farm's own processes have none.

Zenoh's router can thin messages out, but without allowing for bursts, and workers send theirs in bursts; so the books
leave unanswered what is too much, before it is decoded, and say so in a `fault` event.

A question that only reads costs the books what they tell, a hundred times what another does. So each KiB of an answer
to an order counts as a question more, and so do each 4 KiB of a question beyond the first: whoever reads or writes
without end takes the books a share of their time.
"""

from __future__ import annotations

from typing import NamedTuple

RATE_PER_S = 2_000.0  # a thousand workers under one key ask, report and send heartbeats well below this
BURST = 10_000.0
PEERS_MAX = 10_000
ANSWER_BYTES = 1024  # cost the books about as much as a question
QUESTION_BYTES = 4096  # more to read costs as much again
JOIN_COST = 9.0  # questions: a line of the journal for who comes, another for who goes; a thousand may come at once


class _Bucket(NamedTuple):
    tokens: float
    at_s: float


class RateLimit:
    """The buckets of all keys."""

    def __init__(self, rate_per_s: float = RATE_PER_S, burst: float = BURST) -> None:
        self._rate_per_s, self._burst = rate_per_s, burst
        self._buckets: dict[str, _Bucket] = {}

    def allows(self, peer: str, now_s: float, size_bytes: int = 0) -> bool:
        """Count one question of a proven name, a long one as several; False if it asks too much."""
        if not peer:
            return True
        tokens = self._tokens(peer, now_s)
        allowed = tokens >= 1.0
        self._set(peer, tokens - allowed * (1.0 + size_bytes // QUESTION_BYTES), now_s)
        return allowed

    def spend(self, peer: str, questions: float, now_s: float) -> None:
        """Count what else a proven name has cost, in questions; it may ask no more until that is paid off."""
        if peer:
            self._set(peer, self._tokens(peer, now_s) - questions, now_s)

    def _tokens(self, peer: str, now_s: float) -> float:
        bucket = self._buckets.get(peer, _Bucket(self._burst, now_s))
        return min(self._burst, bucket.tokens + self._rate_per_s * (now_s - bucket.at_s))

    def _set(self, peer: str, tokens: float, now_s: float) -> None:
        if len(self._buckets) >= PEERS_MAX and peer not in self._buckets:  # begins all anew, full
            self._buckets.clear()
        self._buckets[peer] = _Bucket(tokens, now_s)
