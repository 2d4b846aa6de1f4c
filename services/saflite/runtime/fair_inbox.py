"""What waits for the thread of the books: a line for each name a certificate proves, bounded, taken in turn.

Zenoh takes messages as fast as links carry them, faster than anybody decodes them: without bounds what waits is memory,
and who sends most is served most. What finds its line full is not answered; who is honest asks again, after a pause.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar, cast

from saflite.bus.base import Request
from saflite.contract.wire import MESSAGE_BYTES_MAX

T = TypeVar("T")
WAITING_MAX = 10_000
WAITING_BYTES_MAX = 2 * MESSAGE_BYTES_MAX


class _Line(Generic[T]):
    def __init__(self) -> None:
        self.waiting: deque[tuple[T, int]] = deque()
        self.size_bytes = 0


class FairInbox(Generic[T]):
    """An inbox for any number of threads that put and one that takes.

    Questions wait in the line of their key, anything else in the one that `line_of` tells, empty for nobody's, and is
    never dropped: a token that vanishes is heard of before the worker's next life that joins.
    """

    def __init__(self, line_of: Callable[[T], str] = lambda _: "") -> None:
        self._line_of = line_of
        self._lines: dict[str, _Line[T]] = {}
        self._change = threading.Condition()
        self._full: dict[str, int] = {}

    def put(self, happening: T) -> None:
        """Let a happening wait; a question of a key whose line is full is dropped."""
        asked = None if isinstance(happening, tuple) else cast("Request", happening)
        peer, size_bytes = (asked.peer, len(asked.payload)) if asked is not None else (self._line_of(happening), 0)
        with self._change:
            line = self._lines.get(peer)
            if line is None:
                line = self._lines[peer] = _Line()
            over = len(line.waiting) >= WAITING_MAX or line.size_bytes + size_bytes > WAITING_BYTES_MAX
            if asked is not None and peer and line.waiting and over:
                self._full[peer] = self._full.get(peer, 0) + 1
                return
            line.waiting.append((happening, size_bytes))
            line.size_bytes += size_bytes
            self._change.notify()

    def take(self, wait_s: float, most: int) -> list[T]:
        """Return up to so many that wait, each line in turn; waits for the first of them."""
        taken: list[T] = []
        with self._change:
            if self.is_empty and wait_s > 0:
                self._change.wait(wait_s)
            while self._lines and len(taken) < most:
                for peer, line in list(self._lines.items()):
                    happening, size_bytes = line.waiting.popleft()
                    line.size_bytes -= size_bytes
                    taken.append(happening)
                    if not line.waiting:
                        del self._lines[peer]
        return taken

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits."""
        return not self._lines

    def dropped(self) -> dict[str, int]:
        """Return how many questions of which keys were dropped since this was asked last."""
        with self._change:
            full, self._full = self._full, {}
        return full
