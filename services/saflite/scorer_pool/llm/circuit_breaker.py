"""A circuit breaker: a server that keeps failing is left alone for a while, then tried with one question."""

from __future__ import annotations

import threading

from saflite.contract.clock import Clock

FAILURES_MAX = 3
REST_FIRST_S, REST_MAX_S = 5.0, 20.0


class Breaker:
    """Closed: questions pass. Open after three failures in a row: none pass for a rest of 5 s, doubled up to 20 s.

    After a rest one question passes; if it is answered the breaker closes, else it rests again. Safe to use from
    several threads.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._failures = 0
        self._rest_s = REST_FIRST_S
        self._open_until_s: float | None = None
        self._trying = False

    def passes(self) -> bool:
        """Return whether a question may be asked now; a True is followed by `succeeded`, `failed` or `abandoned`."""
        with self._lock:
            if self._open_until_s is None:
                return True
            if self._trying or self._clock.monotonic_s() < self._open_until_s:
                return False
            self._trying = True
            return True

    def succeeded(self) -> None:
        """A usable answer came: close."""
        with self._lock:
            self._failures, self._rest_s = 0, REST_FIRST_S
            self._open_until_s, self._trying = None, False

    def failed(self) -> None:
        """No usable answer came: count, and open or rest again where it is enough."""
        with self._lock:
            self._failures += 1
            again, self._trying = self._trying, False
            if again:
                self._rest_s = min(REST_MAX_S, 2.0 * self._rest_s)
            if again or self._failures >= FAILURES_MAX:
                self._open_until_s = self._clock.monotonic_s() + self._rest_s

    def abandoned(self) -> None:
        """The question was taken back before there was an answer: nothing was learned, another may try."""
        with self._lock:
            self._trying = False

    @property
    def is_open(self) -> bool:
        """Whether questions are held back."""
        return self._open_until_s is not None
