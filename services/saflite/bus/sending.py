"""Threads that send: one for each name a certificate proves, so that who does not read keeps only its own waiting.

A link whose other end reads nothing takes what fits into its buffers, then holds up whoever sends on it for a while.
That must be neither the thread of the books nor one of Zenoh's. What a line cannot hold is not sent: askers ask again.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from saflite.contract.wire import MESSAGE_BYTES_MAX

WAITING_MAX = 10_000  # of a line
WAITING_BYTES_MAX = 2 * MESSAGE_BYTES_MAX
FLUSH_S = 1.0


class _Job(NamedTuple):
    act: Callable[[], None]
    size_bytes: int


class _Line:
    """What waits to be sent by one thread."""

    def __init__(self, name: str) -> None:
        self._jobs: deque[_Job] = deque()
        self._bytes, self._closed = 0, False
        self._change = threading.Condition()
        self.thread = threading.Thread(target=self._run, name=f"send-{name}", daemon=True)
        self.thread.start()

    def add(self, job: _Job) -> bool:
        with self._change:
            full = len(self._jobs) >= WAITING_MAX or (self._jobs and self._bytes + job.size_bytes > WAITING_BYTES_MAX)
            if full or self._closed:
                return False
            self._jobs.append(job)
            self._bytes += job.size_bytes
            self._change.notify()
            return True

    def close(self) -> None:
        with self._change:
            self._closed = True
            self._change.notify()

    def _run(self) -> None:
        while True:
            with self._change:
                while not self._jobs and not self._closed:
                    self._change.wait()
                if not self._jobs:
                    return
                job = self._jobs.popleft()
                self._bytes -= job.size_bytes
            job.act()
            del job  # and with it the question it answers, here and not by whoever comes next


class Senders:
    """All lines, by name."""

    def __init__(self) -> None:
        self._lines: dict[str, _Line] = {}
        self._adding = threading.Lock()

    def send(self, name: str, size_bytes: int, act: Callable[[], None]) -> bool:
        """Have something of a size sent by the thread of a name; False if too much waits there. From any thread."""
        line = self._lines.get(name)
        if line is None:
            with self._adding:
                line = self._lines.get(name) or self._lines.setdefault(name, _Line(name))
        return line.add(_Job(act, size_bytes))

    def close(self) -> None:
        """Take no more, and wait up to a second for what is on its way."""
        lines = list(self._lines.values())
        for line in lines:
            line.close()
        for line in lines:
            line.thread.join(FLUSH_S / len(lines))
