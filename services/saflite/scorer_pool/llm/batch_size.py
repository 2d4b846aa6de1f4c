"""How much to ask at once: test cases per question and questions side by side, from measured times."""

from __future__ import annotations

import math
import threading

PER_QUESTION_MAX = 12
SIDE_BY_SIDE_MAX = 8
SHARE_OF_DEADLINE = 0.4
"""A question should take at most this share of the deadline: room for a second one and for a slow moment."""

WORTH = 1.25
"""Two questions side by side must answer this much more per second than one to be worth it."""


class BatchSizer:
    """Sizes questions by the time a test case takes. Safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._case_s: float | None = None
        self._most = PER_QUESTION_MAX
        self.side_by_side = 1

    def per_question(self, deadline_s: float) -> int:
        """Return how many test cases one question should hold so that it is answered well within the deadline."""
        with self._lock:
            if not self._case_s:
                return self._most
            fits = int(SHARE_OF_DEADLINE * deadline_s / self._case_s)
            return max(1, min(self._most, fits))

    def answered(self, cases: int, seconds: float) -> None:
        """Learn from an answer about `cases` test cases that took `seconds`."""
        with self._lock:
            case_s = seconds / max(1, cases)
            self._case_s = case_s if self._case_s is None else 0.7 * self._case_s + 0.3 * case_s
            if self._most < PER_QUESTION_MAX:
                self._most += 1

    def missed(self, cases: int) -> None:
        """Learn from a question about `cases` test cases that was not answered in time: ask about fewer."""
        with self._lock:
            self._most = max(1, min(self._most, cases) // 2)

    def probed(self, seconds: dict[int, float]) -> None:
        """Choose how many questions to put side by side, given how long each number of them took together."""
        best, best_rate = 1, 1.0 / max(seconds.get(1, math.inf), 1e-9)
        for count in sorted(seconds):
            rate = count / max(seconds[count], 1e-9)
            if rate >= WORTH * best_rate:
                best, best_rate = count, rate
        with self._lock:
            self.side_by_side = min(SIDE_BY_SIDE_MAX, best)
