"""The shell around the books: commit before answer, polls that wait, a store without writes, unreadable messages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
import pytest

from saflite.bus.base import Happening, Reply, Sample
from saflite.bus.memory import MemoryBus, MemoryNetwork
from saflite.campaign.engine.outbox import Batch
from saflite.campaign.engine.worker_registry import WORKERS_MAX
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.contract import topics, wire
from saflite.contract.config import Campaign, LeaseConfig
from saflite.contract.control import Answer, Control
from saflite.contract.errors import Unavailable
from saflite.contract.events import Event, FaultSeen, WorkerChanged
from saflite.contract.join import Join, Joined
from saflite.contract.work import Ask, Grant, Heartbeat, MutateResult, Orders, Receipt, Report
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime.books_service import BooksService
from saflite.runtime.software import software_of

T = TypeVar("T")
CAMPAIGN = Campaign(name="c", mission="mission1", budget_flights=5, lease=LeaseConfig(lease_s=2.0))


class _FullDisk:
    """The real store, on a disk that can be filled."""

    def __init__(self, store: Store) -> None:
        self.store, self.full, self.blobs = store, False, store.blobs
        self.snapshot_due, self.keep = True, store.keep
        self.room_bytes = store.room_bytes

    def commit(self, batch: Batch) -> None:
        if self.full and batch:
            raise Unavailable("no space left")
        self.store.commit(batch)


class _Clock:
    def __init__(self, network: MemoryNetwork) -> None:
        self._network = network

    def monotonic_s(self) -> float:
        return 1000.0 + self._network.now_s

    def unix_s(self) -> float:
        return 1.7e9 + self._network.now_s


class Stand(NamedTuple):
    network: MemoryNetwork
    service: BooksService
    store: _FullDisk
    worker: MemoryBus
    answers: list[Happening]

    def turn(self, turns: int = 3, step_s: float = 0.05) -> None:
        for _ in range(turns):
            self.network.run_until(self.network.now_s + step_s)
            self.service.step(0.0)
        self.network.run_until(self.network.now_s)

    def send(self, key: str, message: msgspec.Struct, timeout_s: float = 60.0) -> None:
        self.worker.ask(key, wire.encode(message), len(self.answers), self.answers.append, timeout_s)
        self.turn()

    def last(self, kind: type[T]) -> T:
        reply = self.answers[-1]
        assert isinstance(reply, Reply)
        assert reply.payload is not None
        return wire.decode(reply.payload, kind)


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Stand]:
    network = MemoryNetwork()
    clock = _Clock(network)
    store = Store.create(tmp_path / "run", CAMPAIGN, template(CAMPAIGN), describe())
    books = store.rebuild()
    books.begin(clock.monotonic_s(), clock.unix_s())
    disk = _FullDisk(store)
    service = BooksService(network.connect("books"), "c", books, disk, clock)  # type: ignore[arg-type]
    service.open()
    stand = Stand(network, service, disk, network.connect("w"), [])
    stand.turn()
    for stage in ("mutate", "score"):
        stand.worker.appear(topics.alive("c", stage, "w", "life"))
        stand.send(topics.join("c", stage), _card(stage))
    stand.answers.clear()
    yield stand
    store.close()


def _ask(stage: str, wait_s: float = 5.0, worker: str = "w", session: str = "life") -> Ask:
    return msgspec.convert({"worker": worker, "stage": stage, "wait_s": wait_s, "session": session}, Ask)


def _card(stage: str, worker: str = "w", session: str = "life", **said: object) -> Join:
    card = {"protocol": topics.PROTOCOL, "worker": worker, "session": session, "stage": stage, "host": "there"}
    software = software_of(stage)
    return msgspec.convert({**card, "software": software, "targets": [{"name": "reference"}], **said}, Join)


def _mutated(stand: Stand) -> Report:
    stand.send(topics.work("c", "mutate"), _ask("mutate"))
    (lease,) = stand.last(Grant).leases
    work = lease.work
    cases = tuple(msgspec.structs.replace(template(CAMPAIGN), rng_seed=number) for number in range(10))
    result = MutateResult(round=work.round, test_cases=cases)  # type: ignore[union-attr]
    return Report(worker="w", lease_id=lease.lease_id, epoch=lease.epoch, result=result)


def test_a_result_is_answered_after_its_commit(stand: Stand) -> None:
    stand.send(topics.result("c", "mutate"), _mutated(stand))
    assert stand.last(Receipt).status == "accepted"


def test_a_poll_without_work_waits_and_is_answered_when_work_comes(stand: Stand) -> None:
    stand.send(topics.work("c", "score"), _ask("score", wait_s=8.0))
    assert stand.answers == []
    other = stand.network.connect("other")
    waiting = stand._replace(worker=other, answers=[])
    waiting.send(topics.result("c", "mutate"), _mutated(waiting))
    assert len(stand.last(Grant).leases) == 1


def test_a_poll_that_waited_long_enough_is_told_so(stand: Stand) -> None:
    stand.send(topics.work("c", "score"), _ask("score", wait_s=1.0))
    stand.turn(30)
    assert stand.last(Grant).leases == ()


def trouble_of(stand: Stand) -> str:
    status = stand.last(Answer).status
    assert status is not None
    return status.trouble


def test_while_the_store_takes_no_writes_nothing_is_handed_out_or_acknowledged(stand: Stand) -> None:
    report = _mutated(stand)
    stand.store.full = True
    before = len(stand.answers)
    stand.send(topics.result("c", "mutate"), report, timeout_s=0.3)
    stand.turn(10)
    assert stand.answers[before:] == [Reply(before, None)]
    stand.send(topics.work("c", "score"), _ask("score"))
    assert stand.last(Grant).leases == ()
    stand.send(topics.control("c", "status"), Control(verb="status"))
    assert "no writes" in stand.last(Answer).message
    assert "no space left" in trouble_of(stand)
    stand.send(topics.control("c", "pause"), Control(verb="pause"))
    assert not stand.last(Answer).accepted
    stand.store.full = False
    stand.turn(15)
    stand.send(topics.control("c", "status"), Control(verb="status"))
    assert not trouble_of(stand)
    stand.send(topics.result("c", "mutate"), report)
    assert stand.last(Receipt).status in ("accepted", "duplicate")
    stand.send(topics.work("c", "score"), _ask("score"))
    assert len(stand.last(Grant).leases) == 1


def test_unreadable_messages_are_refused_and_told_but_a_flood_is_told_once_a_second(stand: Stand) -> None:
    told: list[Event] = []
    stand.worker.follow("saflite/2/c/event/fault", lambda fact: told.append(_event(fact)))
    for number in range(50):
        stand.worker.ask(topics.result("c", "fly"), b"\xc1 nonsense", number, stand.answers.append, 5.0)
    stand.turn()
    assert all(isinstance(reply, Reply) and reply.refused for reply in stand.answers)
    assert len(stand.answers) == 50
    stand.turn(40)
    assert 1 <= len(told) <= 3
    assert all(isinstance(event.fact, FaultSeen) and "w on result" in event.fact.where for event in told)


def test_a_worker_whose_token_vanishes_loses_its_leases_at_once(stand: Stand) -> None:
    dying = stand._replace(worker=stand.network.connect("dying"), answers=[])
    dying.worker.appear(topics.alive("c", "mutate", "dying", "life"))
    dying.send(topics.join("c", "mutate"), _card("mutate", "dying"))
    dying.send(topics.work("c", "mutate"), _ask("mutate", worker="dying"))
    assert len(dying.last(Grant).leases) == 1
    told: list[Event] = []
    stand.worker.follow("saflite/2/c/event/worker", lambda fact: told.append(_event(fact)))
    stand.network.crash("dying")
    stand.turn(6)
    assert any(isinstance(event.fact, WorkerChanged) and not event.fact.present for event in told)
    stand.turn(40)  # beyond the first lease time, in which others may still be on their way
    stand.send(topics.work("c", "mutate"), _ask("mutate"))
    assert stand.last(Grant).leases[0].epoch == 2


def test_heartbeats_for_leases_not_held_are_told_to_drop_them(stand: Stand) -> None:
    held = (("old:fly/x/search/0", 1),)
    stand.send(topics.beat("c", "mutate"), Heartbeat(worker="w", stage="mutate", session="life", leases=held))
    assert stand.last(Orders).cancel == ("old:fly/x/search/0",)


def test_who_has_not_joined_is_given_nothing(stand: Stand) -> None:
    for ask in (_ask("mutate", worker="stranger"), _ask("mutate", session="another-life"), _ask("fly")):
        stand.send(topics.work("c", ask.stage), ask)
        assert "joined" in stand.last(Grant).refused
        assert stand.last(Grant).leases == ()
    stand.send(topics.beat("c", "fly"), Heartbeat(worker="stranger", stage="fly", session="life"))
    assert "joined" in stand.last(Orders).refused


def test_who_joins_is_told_what_the_campaign_flies_and_shows_in_the_status(stand: Stand) -> None:
    card = _card("fly", "fly-1", targets=[{"name": "reference", "build": "b1"}], cores=4, labels={"site": "lab"})
    stand.send(topics.join("c", "fly"), card)
    joined = stand.last(Joined)
    assert (joined.accepted, joined.worker, joined.session) == (True, "fly-1", "life")
    assert (joined.campaign, joined.target, joined.lease_s) == ("c", "reference", 2.0)
    stand.send(topics.control("c", "status"), Control(verb="status"))
    status = stand.last(Answer).status
    assert status is not None
    (worker,) = (one for one in status.workers if one.worker == "fly-1")
    assert (worker.host, worker.build, worker.cores, worker.labels) == ("there", "b1", 4, {"site": "lab"})


def test_a_name_is_held_by_one_life_at_a_time_over_all_stages(stand: Stand) -> None:
    told: list[Event] = []
    stand.worker.follow("saflite/2/c/event/fault", lambda fact: told.append(_event(fact)))
    first = stand._replace(worker=stand.network.connect("first"), answers=[])
    first.worker.appear(topics.alive("c", "mutate", "m", "one"))
    first.send(topics.join("c", "mutate"), _card("mutate", "m", "one"))
    first.send(topics.work("c", "mutate"), _ask("mutate", worker="m", session="one"))
    assert first.last(Grant).leases
    for stage in ("mutate", "score"):
        stand.send(topics.join("c", stage), _card(stage, "m", "two"))
        assert not stand.last(Joined).accepted
        assert "in use by a live mutate worker on 'there'" in stand.last(Joined).message
    assert any(isinstance(event.fact, FaultSeen) and "in use" in event.fact.message for event in told)
    stand.network.crash("first")
    stand.network.run_until(stand.network.now_s)
    stand.send(topics.join("c", "mutate"), _card("mutate", "m", "two"))  # at once: long before it counts as certain
    assert stand.last(Joined).accepted
    stand.send(topics.work("c", "mutate"), _ask("mutate"))
    (lease,) = stand.last(Grant).leases
    assert lease.epoch == 2, "the lease of the first life was not freed"


def test_joining_again_under_the_same_session_changes_nothing(stand: Stand) -> None:
    report = _mutated(stand)
    stand.send(topics.join("c", "mutate"), _card("mutate"))
    assert stand.last(Joined).accepted
    stand.send(topics.result("c", "mutate"), report)
    assert stand.last(Receipt).status == "accepted"


def test_the_late_end_of_an_earlier_life_does_not_harm_the_one_that_took_its_place(stand: Stand) -> None:
    stand.service._liveness.vanished(("w", "mutate", "life"), stand.service._clock.monotonic_s())
    stand.send(topics.join("c", "mutate"), _card("mutate", session="two"))
    stand.send(topics.work("c", "mutate"), _ask("mutate", session="two"))
    assert len(stand.last(Grant).leases) == 1
    stand.turn(20)
    stand.send(topics.control("c", "status"), Control(verb="status"))
    status = stand.last(Answer).status
    assert status is not None
    assert [one.leases for one in status.workers if one.stage == "mutate"] == [1]


def test_an_unreadable_wish_to_join_is_refused_in_words(stand: Stand) -> None:
    stand.worker.ask(topics.join("c", "fly"), b"\xc1", 99, stand.answers.append, 5.0)
    stand.turn()
    reply = stand.answers[-1]
    assert isinstance(reply, Reply)
    assert "valid message" in reply.refused


def _journal_lines(stand: Stand) -> int:
    return sum(1 for _ in stand.store.store.journal())


def test_an_order_with_a_number_beyond_reason_is_refused_and_the_books_live_on(stand: Stand) -> None:
    for number in (2**63, 2**64 - 1, -1):
        stand.send(topics.control("c", "events"), Control(verb="events", number=number))
        reply = stand.answers[-1]
        assert isinstance(reply, Reply)
        assert "$.number" in reply.refused
    stand.send(topics.control("c", "status"), Control(verb="status"))
    assert stand.last(Answer).accepted


def test_two_thousand_strangers_leave_nothing_in_the_journal(stand: Stand) -> None:
    before = _journal_lines(stand)
    for number in range(2000):
        name = f"stranger-{number}"
        ask, beat = _ask("fly", worker=name), Heartbeat(worker=name, stage="fly", session="life")
        stand.worker.ask(topics.work("c", "fly"), wire.encode(ask), number, stand.answers.append, 5.0)
        stand.worker.ask(topics.beat("c", "fly"), wire.encode(beat), number, stand.answers.append, 5.0)
    stand.turn(10)
    assert _journal_lines(stand) == before


def test_no_more_workers_may_join_than_a_farm_can_have(stand: Stand) -> None:
    before = _journal_lines(stand)
    for number in range(WORKERS_MAX + 500):
        card = _card("mutate", f"m-{number}")
        stand.worker.ask(topics.join("c", "mutate"), wire.encode(card), number, stand.answers.append, 5.0)
    stand.turn(10)
    assert "as many workers as" in stand.last(Joined).message
    assert stand.last(Joined).retry_after_s > 0.0, "there may be room later: no reason to end"
    assert _journal_lines(stand) - before <= WORKERS_MAX + 20
    stand.send(topics.work("c", "mutate"), _ask("mutate"))
    assert len(stand.last(Grant).leases) == 1


def _event(happening: Happening) -> Event:
    assert isinstance(happening, Sample)
    return wire.decode(happening.payload, Event)


def test_a_result_that_cannot_be_read_is_a_failed_attempt_of_its_lease(stand: Stand) -> None:
    """Its worker is told so at once; otherwise the same work would be lent and answered like this for ever."""
    unread: list[tuple[object, str]] = [
        ({"type": "mutated", "round": -1, "test_cases": []}, "refused"),
        ({"type": "nonsense"}, "stale"),
        (3, "stale"),
    ]
    epochs: list[int] = []
    while len(epochs) < 50:
        stand.send(topics.work("c", "mutate"), _ask("mutate", wait_s=0.0))
        grant = stand.last(Grant)
        if grant.stop:
            break
        (lease,) = grant.leases
        epochs.append(lease.epoch)
        said = {"worker": "w", "lease_id": lease.lease_id, "epoch": lease.epoch}
        for result, status in unread:
            payload = msgspec.msgpack.encode({**said, "result": result})
            stand.worker.ask(topics.result("c", "mutate"), payload, len(stand.answers), stand.answers.append, 60.0)
            stand.turn()
            assert stand.last(Receipt).status == status
    assert epochs == [1, 2, 3, 4, 5], "a strategy whose results cannot be read ends the campaign"


def test_a_damaged_result_is_sent_again_and_costs_no_attempt(stand: Stand) -> None:
    stand.send(topics.work("c", "mutate"), _ask("mutate", wait_s=0.0))
    (lease,) = stand.last(Grant).leases
    payload = wire.encode(
        Report(worker="w", lease_id=lease.lease_id, epoch=1, result=MutateResult(round=0, test_cases=()))
    )
    stand.worker.ask(topics.result("c", "mutate"), payload[:-3], len(stand.answers), stand.answers.append, 60.0)
    stand.turn()
    reply = stand.answers[-1]
    assert isinstance(reply, Reply)
    assert reply.refused
    stand.send(topics.result("c", "mutate"), wire.decode(payload, Report))
    assert stand.last(Receipt).status == "accepted"


def _in_json(stand: Stand, verb: str, text: bytes) -> dict[str, object]:
    stand.worker.ask(topics.control("c", verb), text, len(stand.answers), stand.answers.append, 60.0)
    stand.turn()
    reply = stand.answers[-1]
    assert isinstance(reply, Reply)
    assert reply.payload is not None, reply.refused
    return dict(msgspec.json.decode(reply.payload))


def test_an_order_in_json_is_answered_in_json(stand: Stand) -> None:
    status = _in_json(stand, "status", b'{"verb": "status"}')["status"]
    assert isinstance(status, dict)
    assert status["campaign"] == "c"
    events = _in_json(stand, "events", b'{"verb": "events", "number": 2}')["events"]
    assert isinstance(events, list)
    assert [event["seq"] for event in events] == list(range(2, len(events) + 2))
    assert {"campaign", "worker"} >= {event["fact"]["type"] for event in events} >= {"worker"}


@pytest.mark.parametrize("text", [b"{", b'{"verb": "fly"}', b'{"verb": "stop"}', b"{" + b'"a":[' * 5000])
def test_a_bad_order_in_json_is_refused_in_words(stand: Stand, text: bytes) -> None:
    stand.worker.ask(topics.control("c", "status"), text, "bad", stand.answers.append, 60.0)
    stand.turn()
    reply = stand.answers[-1]
    assert isinstance(reply, Reply)
    assert reply.payload is None
    assert "expected" in reply.refused


def test_facts_are_told_in_json_to_those_who_listen(stand: Stand) -> None:
    heard: list[Happening] = []
    stand.network.connect("page").follow(topics.event_json("c", "*"), heard.append)
    stand.send(topics.join("c", "fly"), _card("fly", worker="x"))
    (sample,) = [one for one in heard if isinstance(one, Sample)]
    assert sample.key == topics.event_json("c", "worker")
    event = msgspec.json.decode(sample.payload, type=Event)
    assert isinstance(event.fact, WorkerChanged)
    assert event.fact.worker == "x"
