"""Time is handed in. The clock that reads the machine's time is `runtime/clock.py`."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Protocol

_LAST_S = 253_402_300_799.0  # the last second of the year 9999


def in_utc(unix_s: float) -> datetime:
    """Return a moment in UTC; one that no calendar has becomes the nearest from 1970 to 9999."""
    return datetime.fromtimestamp(min(max(unix_s, 0.0), _LAST_S) if math.isfinite(unix_s) else 0.0, UTC)


class Clock(Protocol):
    """A source of time."""

    def monotonic_s(self) -> float:
        """Seconds since some fixed moment; never goes back. Leases and deadlines run on it."""
        ...

    def unix_s(self) -> float:
        """Seconds since 1970; only for people to read, never for order."""
        ...
