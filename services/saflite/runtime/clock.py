"""The only reader of the machine's clocks."""

from __future__ import annotations

import time


class WallClock:
    """The machine's own time; see `contract.clock.Clock`."""

    def monotonic_s(self) -> float:
        """Return seconds since boot; never goes back."""
        return time.monotonic()

    def unix_s(self) -> float:
        """Return seconds since 1970."""
        return time.time()

    def sleep_s(self, duration_s: float) -> None:
        """Wait."""
        time.sleep(duration_s)
