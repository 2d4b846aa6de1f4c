"""Time is handed in. The clock that reads the machine's time is `runtime/clock.py`."""

from __future__ import annotations

from typing import Protocol


class Clock(Protocol):
    """A source of time."""

    def monotonic_s(self) -> float:
        """Seconds since some fixed moment; never goes back. Leases and deadlines run on it."""
        ...

    def unix_s(self) -> float:
        """Seconds since 1970; only for people to read, never for order."""
        ...
