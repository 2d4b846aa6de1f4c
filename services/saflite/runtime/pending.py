"""A worker's result on its way to the books: sent until it is answered, ever less often."""

from __future__ import annotations

from saflite.contract.work import Report

TIMEOUT_S, TIMEOUT_MAX_S = 10.0, 80.0  # a long result on a slow line takes longer than a short one
RETRY_FIRST_S, RETRY_MAX_S = 0.1, 2.0
REFUSALS_MAX = 3


class Pending:
    """A result under way to the books."""

    def __init__(self, report: Report, now_s: float) -> None:
        self.report, self.next_s = report, now_s
        self.sending = self.was_sent = False
        self.asks = False  # the worker's next question for work is under way with it
        self.timeout_s = TIMEOUT_S
        self._refusals, self._wait_s = 0, RETRY_FIRST_S

    def is_given_up(self, now_s: float, *, refused: bool) -> bool:
        """Note that it was not taken; whether it was refused too often to be sent again."""
        self.sending, self.was_sent = False, True
        self._refusals += refused
        self.next_s = now_s + self._wait_s
        self._wait_s = min(2 * self._wait_s, RETRY_MAX_S)
        self.timeout_s = min(2 * self.timeout_s, TIMEOUT_MAX_S)
        return self._refusals >= REFUSALS_MAX
