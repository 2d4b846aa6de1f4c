"""What keys may do to the books: tokens and leases that are not theirs, and workers that show no sign of life."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from saflite.bus import memory
from saflite.bus.base import Happening, Presence, Reply, Sample
from saflite.campaign.engine import worker_registry
from saflite.contract import topics, wire
from saflite.contract.control import Answer, Control
from saflite.contract.events import Event, FaultSeen
from saflite.contract.join import Joined
from saflite.contract.work import Grant, Heartbeat, Receipt
from saflite.runtime import liveness

from .test_books_service import Stand, _ask, _card, _mutated, stand  # noqa: F401 (a fixture)


class _OfAKey(memory.MemoryRequest):
    """A question whose asker shows the key of `w`."""

    def __init__(self, key: str, payload: bytes, sender: str, answer: Callable[[bytes | None, str], None]) -> None:
        super().__init__(key, payload, sender, answer)
        self.peer = "w"


def test_a_key_that_shows_more_tokens_than_are_heeded_is_told_of_as_one(
    stand: Stand,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(liveness, "TOKENS_MAX", 3)
    monkeypatch.setattr(stand.service._liveness, "key_of", lambda worker: worker.partition("-")[0])
    told: list[Happening] = []
    stand.network.connect("watcher").follow(topics.event("c", "fault"), told.append)
    for number in range(20):
        stand.worker.appear(topics.alive("c", "fly", f"eve-{number}", "life"))
        stand.worker.appear(topics.alive("c", "fly", f"ana{number}-1", "life"))
    stand.turn(10)
    facts = [wire.decode(one.payload, Event).fact for one in told if isinstance(one, Sample)]
    assert {fact.where for fact in facts if isinstance(fact, FaultSeen)} == {"eve on alive"}
    assert stand.service.crowded == {"eve"}, "so that its connections are ended"


def test_a_key_reports_on_no_lease_of_a_worker_that_did_not_join_with_it(
    stand: Stand,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    report = _mutated(stand)
    broken = wire.encode(report).replace(b"test_cases", b"text_cases")
    monkeypatch.setattr(memory, "MemoryRequest", _OfAKey)  # named as the worker is: of a host, say
    for payload in (wire.encode(report), broken):
        stand.worker.ask(topics.result("c", "mutate"), payload, len(stand.answers), stand.answers.append, 60.0)
        stand.turn()
        reply = stand.answers[-1]
        assert isinstance(reply, Reply)
        assert "joined with the key of w" in reply.refused or "valid message" in reply.refused
    monkeypatch.undo()
    stand.send(topics.result("c", "mutate"), report)
    assert stand.last(Receipt).status == "accepted", "the lease is as it was"


def test_who_joins_without_a_token_holds_no_place_for_long(stand: Stand) -> None:  # noqa: F811
    for number in range(20):
        stand.send(topics.join("c", "mutate"), _card("mutate", f"ghost-{number}"))
        assert stand.last(Joined).accepted
    stand.turn(20, step_s=0.2)
    stand.send(topics.control("c", "status"), Control(verb="status"))
    status = stand.last(Answer).status
    assert status is not None
    assert {one.worker for one in status.workers} == {"w"}


def test_a_worker_that_left_and_joins_anew_is_met_in_that_order_whatever_waits_before_it(
    stand: Stand,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stand.service._liveness, "key_of", lambda worker: worker.partition("-")[0])
    monkeypatch.setattr(memory, "MemoryRequest", _OfAKey)
    stand.worker.appear(topics.alive("c", "fly", "w-1", "life1"))
    stand.send(topics.join("c", "fly"), _card("fly", "w-1", "life1"))
    inbox, answers = stand.service._inbox, list[bytes | None]()
    for number in range(4):  # the host restarts, with all its workers
        inbox.put(Presence(topics.alive("c", "fly", f"v-{number}", "life1"), present=False))
    inbox.put(Presence(topics.alive("c", "fly", "w-1", "life1"), present=False))
    inbox.put(Presence(topics.alive("c", "fly", "w-1", "life2"), present=True))
    card = wire.encode(_card("fly", "w-1", "life2"))
    inbox.put(_OfAKey(topics.join("c", "fly"), card, "w-1", lambda payload, _: answers.append(payload)))
    stand.service.step(0.0)
    (payload,) = answers
    assert payload is not None
    joined = wire.decode(payload, Joined)
    assert joined.accepted, joined.message


def test_a_key_asks_and_shows_signs_of_life_for_no_worker_that_did_not_join_with_it(
    stand: Stand,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stand.worker.appear(topics.alive("c", "mutate", "w-2-1", "secret"))
    stand.send(topics.join("c", "mutate"), _card("mutate", "w-2-1", "secret"))
    monkeypatch.setattr(memory, "MemoryRequest", _OfAKey)
    beat = Heartbeat(worker="w-2-1", stage="mutate", session="secret", leases=(), state="idle")
    ask = _ask("mutate", worker="w-2-1", session="secret")
    for topic, message in ((topics.work("c", "mutate"), ask), (topics.beat("c", "mutate"), beat)):
        stand.send(topic, message)
        reply = stand.answers[-1]
        assert isinstance(reply, Reply)
        assert "joined with the key of w" in reply.refused
    monkeypatch.undo()
    stand.send(topics.work("c", "mutate"), ask)
    assert stand.last(Grant).leases, "whoever joined is given work as before"


def test_who_waits_for_a_place_in_a_full_farm_writes_nothing(
    stand: Stand,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(worker_registry, "WORKERS_MAX", 1)
    told: list[Happening] = []
    stand.network.connect("watcher").follow(topics.event("c", "fault"), told.append)
    for number in range(6):
        stand.send(topics.join("c", "fly"), _card("fly", f"z-{number}", "life"))
        stand.turn(10)
    assert stand.last(Joined).retry_after_s > 0
    assert told == []
