"""An order whose answer was lost is asked again; that it was taken by then is no refusal."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from saflite.bus.base import Happening, Reply
from saflite.contract import wire
from saflite.contract.control import Control, Verb
from saflite.contract.events import ScorerChanged
from saflite.runtime.client import FarmClient

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, MemoryStore, new_books


class _Clock:
    now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return self.now_s


class _Link:
    """Carries every question to the books; the first answers are lost."""

    def __init__(self, driver: Driver, clock: _Clock, lost: int) -> None:
        self.driver, self.clock, self.lost = driver, clock, lost

    def ask(self, key: str, payload: bytes, tag: object, inbox: Callable[[Happening], None], timeout_s: float) -> None:
        answer = self.driver.books.control(wire.decode(payload, Control), self.driver.now)
        self.driver.commit()
        self.lost, is_lost = self.lost - 1, self.lost > 0
        self.clock.now_s += timeout_s if is_lost else 0.01
        inbox(Reply(tag, None if is_lost else wire.encode(answer)))

    def renew(self) -> None:
        pass

    def access(self) -> str:
        return ""


@pytest.mark.parametrize("lost", [1, 2])
@pytest.mark.parametrize(
    ("verb", "text", "number", "first"),
    [
        ("stop", "", 0, []),
        ("pause", "", 0, []),
        ("resume", "", 0, ["pause"]),
        ("budget", "", 30, []),
        ("scorer", "gap", 0, []),
        ("shadow", "gap,novelty", 0, []),
    ],
)
def test_an_order_that_was_taken_is_not_told_as_refused(
    verb: Verb, text: str, number: int, first: list[Verb], lost: int
) -> None:
    driver, clock = new_books(20), _Clock()
    for one in first:
        assert driver.books.control(Control(verb=one), driver.now).accepted
    client = FarmClient(_Link(driver, clock, lost), "farm-test", clock)  # type: ignore[arg-type]
    answer = client.order(verb, text, number)
    assert (answer.accepted, answer.message) == (True, "")
    while driver.do("score"):  # whatever is warmed
        pass
    status = driver.books.status(driver.now)
    found = {"stop": status.state, "pause": status.state, "resume": status.state}.get(verb)
    assert found == {"stop": "ended", "pause": "paused", "resume": "running"}.get(verb)
    assert status.budget == (30 if verb == "budget" else 20)
    assert status.scorer == ("gap" if verb == "scorer" else "scripted")
    store: object = driver.store
    assert isinstance(store, MemoryStore)
    changes = [event.fact for event in store.all_events if isinstance(event.fact, ScorerChanged)]
    assert all(change.ready for change in changes), "a change under way was dropped for the same one"
    assert len(changes) == len(text.split(",")) * bool(text)


def test_what_was_refused_at_once_is_refused() -> None:
    driver, clock = new_books(20), _Clock()
    client = FarmClient(_Link(driver, clock, 0), "farm-test", clock)  # type: ignore[arg-type]
    assert not client.order("resume").accepted
    assert not client.order("scorer", "scripted").accepted


def test_what_is_refused_again_stays_refused() -> None:
    driver, clock = new_books(20), _Clock()
    client = FarmClient(_Link(driver, clock, 1), "farm-test", clock)  # type: ignore[arg-type]
    assert not client.order("scorer", "no name").accepted
