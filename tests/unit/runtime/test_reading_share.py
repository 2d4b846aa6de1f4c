"""Who only reads takes the books no more than a share of their time, within the rate that a key may ask at."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.bus.memory import MemoryNetwork, MemoryRequest
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.contract import topics, wire
from saflite.contract.config import Campaign
from saflite.contract.control import Answer, Control, Verb
from saflite.contract.join import Join
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime.books_service import BooksService
from saflite.runtime.rate_limit import ANSWER_BYTES, BURST, RATE_PER_S

CAMPAIGN = Campaign(name="c", mission="mission1", budget_flights=5)
STEP_S = 0.05


class _Clock:
    now_s = 1000.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return 1.7e9 + self.now_s


class Stand:
    """Books with a history and many workers, and whoever asks under a proven name."""

    def __init__(self, store: Store) -> None:
        self.clock, self.told = _Clock(), dict[str, list[bytes]]()
        books = store.rebuild()
        books.begin(self.clock.now_s, self.clock.unix_s())
        for number in range(300):
            card = Join(protocol=topics.PROTOCOL, worker=f"w{number}", stage="record", host="of-that-name")
            assert not books.join(card, self.clock.now_s)
        self.service = BooksService(MemoryNetwork().connect("books"), "c", books, store, self.clock)
        self.service.step(0.0)

    def ask(self, peer: str, verb: Verb, *, in_json: bool = False) -> None:
        """Have a question put by the holder of a key."""
        control = Control(verb=verb, number=1)
        payload = wire.encode_json(control) if in_json else wire.encode(control)
        answers = self.told.setdefault(peer, [])
        request = MemoryRequest(
            topics.control("c", verb), payload, peer, lambda data, _: answers.append(data) if data else None
        )
        request.peer = peer
        self.service._inbox.put(request)

    def step(self) -> None:
        """Let some time pass, and the books answer."""
        self.clock.now_s += STEP_S
        while self.service.step(0.0):
            pass


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Stand]:
    store = Store.create(tmp_path / "run", CAMPAIGN, template(CAMPAIGN), describe())
    yield Stand(store)
    store.close()


@pytest.mark.parametrize("verb", ["events", "status"])
@pytest.mark.parametrize("in_json", [False, True])
def test_a_key_is_told_no_more_than_its_share_and_others_all_the_while(stand: Stand, verb: Verb, in_json: bool) -> None:
    steps, most_a_step = 40, round(0.9 * RATE_PER_S * STEP_S)
    for _ in range(steps):
        for _ in range(most_a_step):
            stand.ask("evil", verb, in_json=in_json)
        stand.ask("ana", "status")
        stand.step()
    told = stand.told["evil"]
    longest = max(map(len, told))
    assert longest > 10 * ANSWER_BYTES
    assert sum(map(len, told)) <= ANSWER_BYTES * (BURST + RATE_PER_S * STEP_S * steps) + longest
    assert len(stand.told["ana"]) == steps
    assert wire.decode(stand.told["ana"][-1], Answer).status is not None


def test_whoever_reads_on_after_a_while_is_told_again(stand: Stand) -> None:
    many = 2 * round(BURST)
    for _ in range(many):
        stand.ask("ana", "events")
    stand.step()
    answered = len(stand.told["ana"])
    assert 0 < answered < many
    for _ in range(round(5.0 / STEP_S)):
        stand.step()
    stand.ask("ana", "events")
    stand.step()
    assert len(stand.told["ana"]) == answered + 1
