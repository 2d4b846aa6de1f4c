"""Long polls that found no work and wait for some: lines by stage and target, first come first served."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import NamedTuple

from saflite.bus.base import Request
from saflite.contract.work import Ask, Stage, TargetBuild

WAIT_MAX_S = 10.0
PASSED_OVER_MAX = 4  # work may exist that the first in line may not have (a re-flight wants another worker)

Line = tuple[Stage, tuple[TargetBuild, ...]]


class WaitingPoll(NamedTuple):
    """One waiting poll."""

    request: Request
    ask: Ask
    until_s: float


class LongPollQueue:
    """All waiting polls. Trying them stays cheap however many wait: a line is left after a few that got nothing."""

    def __init__(self) -> None:
        self._lines: dict[Line, OrderedDict[str, WaitingPoll]] = {}
        self._passed: dict[Line, int] = {}
        self._expires_s = float("inf")

    def __len__(self) -> int:
        return sum(len(line) for line in self._lines.values())

    def add(self, request: Request, ask: Ask, now_s: float) -> bool:
        """Let a poll wait; False if it does not want to. A worker's new poll takes the place of its old one."""
        if not ask.wait_s > 0:
            return False
        until_s = now_s + min(ask.wait_s, WAIT_MAX_S)
        self.forget(ask.worker)
        line = self._lines.setdefault((ask.stage, ask.targets), OrderedDict())
        line[ask.worker] = WaitingPoll(request, ask, until_s)
        self._expires_s = min(self._expires_s, until_s)
        return True

    def forget(self, worker: str) -> None:
        """Drop the polls of a worker that is gone."""
        for line in self._lines.values():
            line.pop(worker, None)
        self._lines = {name: line for name, line in self._lines.items() if line}

    def lines(self) -> list[Line]:
        """Return the lines in which somebody waits."""
        self._passed.clear()
        return [name for name, line in self._lines.items() if line]

    def to_try(self, name: Line) -> Iterator[WaitingPoll]:
        """Yield the polls of a line in order, each once; of each is to be said that it was granted or passed over."""
        line = self._lines[name]
        for _ in range(len(line)):
            yield next(iter(line.values()))

    def granted(self, name: Line, poll: WaitingPoll) -> None:
        """Take a poll out that was answered."""
        self._lines[name].pop(poll.ask.worker, None)

    def passed_over(self, name: Line, poll: WaitingPoll) -> bool:
        """Send a poll that got nothing to the end of its line; True while trying the next is worth it."""
        self._lines[name].move_to_end(poll.ask.worker)
        self._passed[name] = self._passed.get(name, 0) + 1
        return self._passed[name] < PASSED_OVER_MAX

    def expired(self, now_s: float) -> list[WaitingPoll]:
        """Take out and return the polls whose time is up."""
        if now_s < self._expires_s:
            return []
        over = [(name, poll) for name, line in self._lines.items() for poll in line.values()]
        late = [(name, poll) for name, poll in over if poll.until_s <= now_s]
        for name, poll in late:
            self.granted(name, poll)
        left = [poll.until_s for name, poll in over if poll.until_s > now_s]
        self._expires_s = min(left, default=float("inf"))
        return [poll for _, poll in late]
