"""The client of a farm: it asks again, and over a new link where the old one carries nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from saflite.bus.base import Inbox, Reply
from saflite.contract import wire
from saflite.contract.control import Answer, Control
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import CampaignChanged, Event
from saflite.runtime.client import ANSWER_S, FarmClient

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, MemoryStore, new_books


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


QUESTIONS_MAX = 20


class _Books:
    """A link to books that answer at once; who asks them again and again waits for what never comes."""

    def __init__(self, driver: Driver) -> None:
        self._driver, self._asked = driver, 0

    def ask(self, _key: str, payload: bytes, tag: Any, inbox: Inbox, _timeout_s: float) -> None:
        self._asked += 1
        assert self._asked <= QUESTIONS_MAX, "waits for ever"
        answer = self._driver.books.control(wire.decode(payload, Control), self._driver.now)
        inbox(Reply(tag, wire.encode(answer)))

    def follow(self, _key: str, _inbox: Inbox) -> None:
        pass


@pytest.mark.parametrize("leaves", [False, True])
def test_a_campaign_is_followed_to_its_last_end_and_no_further(leaves: bool) -> None:
    """Stopped and taken up again it goes on after an end; what has ended and was told whole is not waited for."""
    driver = new_books(12)
    store: object = driver.store
    assert isinstance(store, MemoryStore)
    driver.run(until_flights=4)
    assert driver.books.control(Control(verb="stop"), driver.now).accepted
    driver.commit()
    driver = Driver(store.rebuild(), driver.store)
    driver.run()
    if leaves:
        driver.books.absent("a", "fly", driver.now, why="the farm has ended")
        driver.commit()
    events = store.all_events
    states = [getattr(event.fact, "state", "") for event in events]
    assert states.count("ended") == 2
    assert (states[-1] == "ended") != leaves
    for from_seq in (1, len(events), len(events) + 1):
        client = FarmClient(_Books(driver), "night", _Clock())  # type: ignore[arg-type]
        assert list(client.watch(from_seq)) == events[from_seq - 1 :]


class _Liar:
    """A link to books that answer with something else than what they were asked for."""

    def __init__(self, answer: Callable[[int], Answer]) -> None:
        self._answer, self._asked = answer, 0

    def ask(self, _key: str, payload: bytes, tag: Any, inbox: Inbox, _timeout_s: float) -> None:
        self._asked += 1
        assert self._asked <= QUESTIONS_MAX, "asks for ever"
        inbox(Reply(tag, wire.encode(self._answer(wire.decode(payload, Control).number))))

    def follow(self, _key: str, _inbox: Inbox) -> None:
        pass


def _events(*numbers: int) -> tuple[bytes, ...]:
    made = (Event(seq=number, at_unix_s=1.0, fact=CampaignChanged(state="running")) for number in numbers)
    return tuple(map(wire.encode, made))


@pytest.mark.parametrize("shift", [(1,), (1000, 1002), (-1,), (0, 0), (0, 2), (2, 1, 0)])
def test_books_that_answer_with_other_events_are_not_asked_for_ever(shift: tuple[int, ...]) -> None:
    link = _Liar(lambda asked: Answer(accepted=True, events=_events(*(max(0, asked + more) for more in shift))))
    with pytest.raises(Refused, match="expected events from"):
        for _ in FarmClient(link, "night", _Clock()).watch():  # type: ignore[arg-type]
            pass


def test_books_that_tell_no_status_are_refused() -> None:
    link = _Liar(lambda _: Answer(accepted=True))
    with pytest.raises(Refused, match="expected a status, got none"):
        FarmClient(link, "night", _Clock()).status()  # type: ignore[arg-type]
