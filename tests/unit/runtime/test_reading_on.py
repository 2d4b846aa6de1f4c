"""Whoever reads the campaign's history gets past every place of it, however long its words are."""

from __future__ import annotations

import queue
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from saflite.bus.base import Happening, Reply
from saflite.campaign.engine.read_model import EVENTS_BYTES_MAX, EVENTS_MAX
from saflite.campaign.storage.store import Store
from saflite.contract import wire
from saflite.contract.bounds import TEXT_CHARS_MAX
from saflite.contract.control import Control
from saflite.runtime.client import FarmClient
from saflite.runtime.clock import WallClock
from saflite.runtime.questions import encoded

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles, new_books

LONGEST = 4 * TEXT_CHARS_MAX  # characters that a fault may be told in


class _Question(NamedTuple):
    payload: bytes


class _Link:
    """Carries every question to the books; facts are not carried live."""

    def __init__(self, driver: Driver) -> None:
        self.driver, self.asked = driver, 0

    def follow(self, key: str, inbox: Callable[[Happening], None]) -> None:
        pass

    def ask(self, key: str, payload: bytes, tag: object, inbox: Callable[[Happening], None], timeout_s: float) -> None:
        self.asked += 1
        answer = self.driver.books.control(wire.decode(payload, Control), self.driver.now)
        inbox(Reply(tag, wire.encode(answer)))

    def renew(self) -> None:
        raise queue.Empty

    def access(self) -> str:
        return ""


@pytest.fixture(params=["memory", "disk"])
def driver(request: pytest.FixtureRequest, tmp_path: Path) -> Driver:
    if request.param == "memory":
        return new_books(3)
    store = Store.create(tmp_path / "run", doubles.campaign(3), doubles.TEMPLATE, doubles.TARGET)
    return Driver(store.rebuild(), store)


@pytest.mark.parametrize("words", ["\U0001f600" * LONGEST, "\x01" * LONGEST, "\U0001f600" * 70_000, "short"])
def test_a_watcher_gets_past_long_words(driver: Driver, words: str) -> None:
    many = 36 if len(words) > 1_000 else 2 * EVENTS_MAX + 1
    for _ in range(many):
        driver.books.fault("peer", words, driver.now)
    driver.commit()
    driver.run()
    link = _Link(driver)
    client = FarmClient(link, "farm-test", WallClock())  # type: ignore[arg-type]
    seen = [event.seq for event in client.watch(1)]
    assert seen == list(range(1, driver.books.status(driver.now).seq + 1))
    assert link.asked > 2, "they went into a few answers"


@pytest.mark.parametrize("words", ["\U0001f600" * LONGEST, "\x01" * LONGEST, "short"])
def test_an_answer_is_as_long_as_one_may_be_whatever_it_is_asked_in(driver: Driver, words: str) -> None:
    for _ in range(36):
        driver.books.fault("peer", words, driver.now)
    driver.commit()
    for payload in (b'{"verb":"events","number":1}', wire.encode(Control(verb="events", number=1))):
        answer = driver.books.control(Control(verb="events", number=1), driver.now)
        assert answer.events
        assert sum(map(len, answer.events[:-1])) <= EVENTS_BYTES_MAX
        data = encoded(_Question(payload), answer)  # type: ignore[arg-type]
        assert len(data) < wire.MESSAGE_BYTES_MAX / 2
