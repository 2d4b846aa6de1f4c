"""How much a key may ask: a token bucket for each name a certificate proves; the farm's own processes have none.

Zenoh's router can thin messages out, but without allowing for bursts, and workers send theirs in bursts; so the books
leave unanswered what is too much, before it is decoded, and say so in a `fault` event.
"""

from __future__ import annotations

from typing import NamedTuple

RATE_PER_S = 2_000.0  # a thousand workers under one key ask, report and send heartbeats well below this
BURST = 10_000.0
PEERS_MAX = 10_000


class _Bucket(NamedTuple):
    tokens: float
    at_s: float


class RateLimit:
    """The buckets of all keys."""

    def __init__(self, rate_per_s: float = RATE_PER_S, burst: float = BURST) -> None:
        self._rate_per_s, self._burst = rate_per_s, burst
        self._buckets: dict[str, _Bucket] = {}

    def allows(self, peer: str, now_s: float) -> bool:
        """Count one question of a proven name; False if it asks too much."""
        if not peer:
            return True
        bucket = self._buckets.get(peer, _Bucket(self._burst, now_s))
        tokens = min(self._burst, bucket.tokens + self._rate_per_s * (now_s - bucket.at_s))
        allowed = tokens >= 1.0
        if len(self._buckets) >= PEERS_MAX and peer not in self._buckets:  # begins all anew, full
            self._buckets.clear()
        self._buckets[peer] = _Bucket(tokens - allowed, now_s)
        return allowed
