"""The client of a farm: it asks again, and over a new link where the old one carries nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from saflite.bus.base import Inbox, Reply
from saflite.contract import wire
from saflite.contract.control import Answer
from saflite.contract.errors import Unavailable
from saflite.runtime.client import ANSWER_S, FarmClient


class _Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return 1.7e9 + self.now_s

    def sleep_s(self, duration_s: float) -> None:
        self.now_s += duration_s


class _Link:
    """A link on which each question costs what is said, and is answered once `alive` says so."""

    def __init__(self, clock: _Clock, cost_s: float, alive: Callable[[int], bool]) -> None:
        self._clock, self._cost_s, self._alive, self.renewed = clock, cost_s, alive, 0

    def ask(self, _key: str, _payload: bytes, tag: Any, inbox: Inbox, _timeout_s: float) -> None:
        alive = self._alive(self.renewed)
        self._clock.now_s += 0.0 if alive else self._cost_s
        inbox(Reply(tag, wire.encode(Answer(accepted=True)) if alive else None))

    def renew(self) -> None:
        self.renewed += 1

    def access(self) -> str:
        return ""


def _client(clock: _Clock, link: _Link) -> FarmClient:
    return FarmClient(link, "night", clock)  # type: ignore[arg-type]


def test_a_link_that_looks_alive_and_carries_nothing_is_made_anew() -> None:
    clock = _Clock()
    link = _Link(clock, ANSWER_S, lambda renewed: renewed > 0)
    assert _client(clock, link).order("pause").accepted
    assert link.renewed == 1


def test_books_that_are_away_do_not_make_the_link_anew() -> None:
    clock = _Clock()
    link = _Link(clock, 0.5, lambda _: False)
    with pytest.raises(Unavailable, match="did not answer for 3 s"):
        _client(clock, link).order("pause", within_s=3.0)
    assert not link.renewed, "that nobody is there was said at once"
