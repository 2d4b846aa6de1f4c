"""What waits for the books: bounded for each key in bytes and number, and taken in turn."""

from __future__ import annotations

from saflite.bus.base import Presence, Request
from saflite.runtime import fair_inbox
from saflite.runtime.fair_inbox import FairInbox


class _Question:
    """A question of a key, as the bus hands it over."""

    key, sender, damaged = "", "", ""

    def __init__(self, peer: str, size_bytes: int = 1) -> None:
        self.peer, self.payload = peer, bytes(size_bytes)

    def reply(self, payload: bytes) -> None:
        """See `Request.reply`."""

    def refuse(self, text: str) -> None:
        """See `Request.refuse`."""


def _inbox(*questions: _Question) -> FairInbox[Request | Presence]:
    inbox: FairInbox[Request | Presence] = FairInbox()
    for question in questions:
        inbox.put(question)
    return inbox


def _peers(inbox: FairInbox[Request | Presence], most: int = 100_000) -> list[str]:
    return [one.peer for one in inbox.take(0.0, most) if not isinstance(one, Presence)]


def test_what_one_key_sends_is_bounded_in_bytes_and_dropped_questions_are_counted() -> None:
    quarter = fair_inbox.WAITING_BYTES_MAX // 4
    inbox = _inbox(*(_Question("eve", quarter) for _ in range(10)), _Question("ana"), _Question(""))
    assert sorted(_peers(inbox)) == ["", "ana", *["eve"] * 4]
    assert (inbox.dropped(), inbox.dropped()) == ({"eve": 6}, {})
    inbox.put(_Question("eve", quarter))
    assert _peers(inbox) == ["eve"], "what was taken makes room"


def test_what_one_key_sends_is_bounded_in_number() -> None:
    inbox = _inbox(*(_Question("eve") for _ in range(fair_inbox.WAITING_MAX + 5)))
    assert len(_peers(inbox)) == fair_inbox.WAITING_MAX
    assert inbox.dropped() == {"eve": 5}


def test_what_no_key_sent_is_never_dropped() -> None:
    inbox = _inbox(*(_Question("") for _ in range(fair_inbox.WAITING_MAX + 5)))
    inbox.put(Presence("alive", present=True))
    assert len(inbox.take(0.0, 100_000)) == fair_inbox.WAITING_MAX + 6


def test_each_key_is_served_in_turn_and_in_its_order() -> None:
    flood = [_Question("eve", number) for number in range(1_000)]
    inbox = _inbox(*flood, _Question("ana"), _Question(""))
    first = inbox.take(0.0, 3)
    assert {one.peer for one in first if not isinstance(one, Presence)} == {"eve", "ana", ""}
    rest = [len(one.payload) for one in inbox.take(0.0, 10_000) if not isinstance(one, Presence)]
    assert rest == list(range(1, 1_000))
    assert inbox.take(0.0, 10) == []
