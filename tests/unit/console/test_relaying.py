"""A bridge to a farm elsewhere: nothing that was fetched is lost, whatever comes first, and what may be is said."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import httpx
import msgspec
import pytest

from saflite.campaign.storage.store import Store
from saflite.console.cli import REFUSED, main
from saflite.console.operations import bridging
from saflite.console.operations.relaying import RECEIVER_S, Bridge, relay
from saflite.console.run_data.run_folder import open_run
from saflite.contract import wire
from saflite.contract.control import Control
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import Event, FaultSeen, kind_of
from saflite.runtime import waiting_events
from saflite.runtime.client import FarmClient
from saflite.runtime.waiting_events import WaitingEvents, waiting_file
from saflite.runtime.webhook import Cursor, Webhook, keep_cursor, read_cursor

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles
from bridge_doubles import CAMPAIGN, Clock, Farm, Receiver

PATIENCE_S = 30.0


def flown(run: Path, flights: int = 6) -> tuple[Driver, list[Event]]:
    """Fly a campaign to its end; its books, and all events."""
    store = Store.create(run, doubles.campaign(flights), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run()
    with open_run(run) as folder:
        return driver, list(folder.events())


def relayed(
    cursor: Path,
    connect: Callable[[], FarmClient],
    receiver: Receiver,
    clock: Clock,
    *kinds: str,
    say: Callable[[str], None] = lambda _: None,
) -> None:
    """Have a bridge work to its end."""
    webhook = Webhook("http://127.0.0.1:9/x", clock, b"", httpx.MockTransport(receiver.receive))
    try:
        relay(connect, Bridge(frozenset(kinds), webhook, cursor), clock, say, PATIENCE_S)
    finally:
        webhook.close()


def gone() -> FarmClient:
    raise Unavailable("nobody is there")


@pytest.mark.parametrize("kinds", [(), ("violation",), ("fault",)])
def test_the_farm_may_end_while_the_receiver_is_away(kinds: tuple[str, ...], tmp_path: Path) -> None:
    driver, events = flown(tmp_path / "run")
    wanted = [event for event in events if not kinds or kind_of(event.fact) in kinds]
    cursor, clock, receiver = tmp_path / "c.json", Clock(), Receiver(is_up=False)
    farm = Farm(driver, clock)

    def ends() -> None:
        farm.leaves()
        receiver.up()

    farm.at_end = ends
    relayed(cursor, farm.connect, receiver, clock, *kinds)
    assert receiver.taken == wanted
    assert not waiting_file(cursor).exists()
    relayed(cursor, gone, receiver, Clock(), *kinds)
    assert receiver.taken == wanted, "it is over and told: at once"


@pytest.mark.parametrize("torn", [b"", b"\x05", b"\x05\0\0\0\0\0\0\0half"])
@pytest.mark.parametrize("by_run", [False, True])
def test_a_bridge_killed_after_the_farm_ended_is_gone_on_with(
    torn: bytes, by_run: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, events = flown(tmp_path / "run")
    cursor, left, clock, receiver = tmp_path / "c.json", tmp_path / "left.json", Clock(), Receiver(is_up=False)
    farm = Farm(driver, clock)

    def killed() -> None:
        shutil.copy(cursor, left)
        waiting_file(left).write_bytes(waiting_file(cursor).read_bytes() + torn)
        receiver.up()

    farm.at_end = killed
    relayed(cursor, farm.connect, receiver, clock)
    assert driver.store is not None
    driver.store.close()
    receiver.taken.clear()
    if by_run:
        made = Webhook("http://127.0.0.1:9/x", clock, b"", httpx.MockTransport(receiver.receive))
        monkeypatch.setattr(bridging, "Webhook", lambda *_: made)
        words = ["watch", str(tmp_path / "run"), "--webhook", "http://127.0.0.1:9/x", "--cursor", str(left)]
        assert main(words) == 0
        again = read_cursor(left)
        assert again is not None
        assert again.end == events[-1].seq
    else:
        relayed(left, gone, receiver, Clock())
    assert receiver.taken == events
    assert not waiting_file(left).exists()


@pytest.mark.parametrize("is_up", [False, True])
def test_a_farm_that_ends_while_a_page_is_fetched_is_told_of(is_up: bool, tmp_path: Path) -> None:
    driver, events = flown(tmp_path / "run")
    cursor, clock, receiver, said = tmp_path / "c.json", Clock(), Receiver(is_up=is_up), list[str]()
    farm = Farm(driver, clock, answers=2, page=5)  # the first event, and a page
    with pytest.raises(Unavailable, match="events from number 6 on may be missing") as fault:
        relayed(cursor, farm.connect, receiver, clock, say=said.append)
    assert clock.now_s >= PATIENCE_S
    assert f"until nothing came for {PATIENCE_S:.0f} s" in said[0]
    assert is_up or f"5 that were fetched wait in {waiting_file(cursor)}" in str(fault.value)
    receiver.up()
    relayed(cursor, Farm(driver, (clock := Clock())).connect, receiver, clock)
    assert receiver.taken == events, "the same command goes on"


def test_one_that_begins_after_the_farm_ended_ends_too(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="events from number 1 on may be missing"):
        relayed(tmp_path / "c.json", gone, Receiver(), Clock())


def test_a_receiver_that_never_takes_it_ends_the_bridge(tmp_path: Path) -> None:
    driver, _ = flown(tmp_path / "run")
    clock, receiver = Clock(), Receiver()
    receiver.code = 410
    with pytest.raises(Refused, match="HTTP 410 for event 1"):
        relayed(tmp_path / "c.json", Farm(driver, clock).connect, receiver, clock)


def test_no_more_waits_than_the_bound_and_the_rest_is_fetched_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, events = flown(tmp_path / "run")
    most = max(len(wire.encode(event)) for event in events)
    monkeypatch.setattr(waiting_events, "BYTES_MAX", 4 * most)
    monkeypatch.setattr(waiting_events, "TAKEN_BYTES_MAX", most)
    cursor, clock, receiver, sizes = tmp_path / "c.json", Clock(), Receiver(is_up=False), list[int]()

    def say(words: str) -> None:
        assert "is full" in words
        sizes.append(waiting_file(cursor).stat().st_size)
        receiver.up()

    relayed(cursor, Farm(driver, clock).connect, receiver, clock, say=say)
    assert receiver.taken == events
    assert sizes
    assert max(sizes) < 5 * most + 100


@pytest.mark.parametrize("farm_goes", [True, False])
def test_a_receiver_that_is_gone_while_no_more_can_wait_ends_the_bridge(
    farm_goes: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It waited for ever: a farm that was not asked was taken for one that had answered."""
    driver, _ = flown(tmp_path / "run")
    monkeypatch.setattr(waiting_events, "BYTES_MAX", 1_000)
    cursor, clock = tmp_path / "c.json", Clock()
    farm = Farm(driver, clock)
    farm.at_end = farm.leaves if farm_goes else farm.at_end
    with pytest.raises(Unavailable) as fault:
        relayed(cursor, farm.connect, Receiver(is_up=False), clock)
    why = "nothing was fetched for 30 s" if farm_goes else "the receiver took nothing for 300 s"
    for part in (why, "may be missing", str(waiting_file(cursor)), "the same command goes on"):
        assert part in str(fault.value)
    assert clock.monotonic_s() <= RECEIVER_S + 5.0


def test_what_waits_and_is_not_in_the_books_any_more_is_not_told(tmp_path: Path) -> None:
    """Its commit was lost with others, and its number given again."""
    driver, events = flown(tmp_path / "run")
    cursor, said = tmp_path / "c.json", list[str]()
    waiting = WaitingEvents(cursor, frozenset())
    waiting.begin(Cursor(campaign=CAMPAIGN, begun_unix_s=events[0].at_unix_s))
    for event in (*events[:3], msgspec.structs.replace(events[3], fact=FaultSeen(where="here", message="lost"))):
        waiting.add(event)
    waiting.close(over=False)
    clock, receiver = Clock(), Receiver(is_up=False)
    farm = Farm(driver, clock)
    farm.at_end = lambda: receiver.up() if said else None
    relayed(cursor, farm.connect, receiver, clock, say=said.append)
    assert "4 events that waited are none of this run" in said[0]
    assert receiver.taken[-len(events) :] == events


def test_a_campaign_taken_up_again_is_followed_on(tmp_path: Path) -> None:
    driver, events = flown(tmp_path / "run")
    cursor, clock, receiver = tmp_path / "c.json", Clock(), Receiver()
    relayed(cursor, Farm(driver, clock).connect, receiver, clock)
    assert driver.books.control(Control(verb="budget", number=8), driver.now).accepted
    driver.commit()
    with pytest.raises(Unavailable, match="may be missing"):
        relayed(cursor, Farm(driver, (clock := Clock()), answers=5).connect, receiver, clock)
    driver.run()
    relayed(cursor, Farm(driver, (clock := Clock())).connect, receiver, clock)
    with open_run(tmp_path / "run") as folder:
        assert receiver.taken == list(folder.events())
    assert len(receiver.taken) > len(events)


def test_two_bridges_do_not_share_a_cursor(tmp_path: Path) -> None:
    cursor = tmp_path / "c.json"
    waiting = WaitingEvents(cursor, frozenset())
    with pytest.raises(Refused, match="one in use"):
        WaitingEvents(cursor, frozenset())
    flown(tmp_path / "run")[0].store.close()  # type: ignore[union-attr]
    assert (
        main(["watch", str(tmp_path / "run"), "--webhook", "http://127.0.0.1:9/x", "--cursor", str(cursor)]) == REFUSED
    )
    waiting.close(over=False)
    assert waiting_file(cursor).stat().st_mode & 0o777 == 0o600, "a webhook is told less than what waits"


def test_no_event_of_kinds_that_did_not_wait_is_left_out(tmp_path: Path) -> None:
    driver, events = flown(tmp_path / "run")
    cursor, clock, receiver = tmp_path / "c.json", Clock(), Receiver(is_up=False)
    keep_cursor(cursor, Cursor(campaign=CAMPAIGN, begun_unix_s=events[0].at_unix_s))
    farm = Farm(driver, clock, answers=3, page=len(events) // 2)
    with pytest.raises(Unavailable):
        relayed(cursor, farm.connect, receiver, clock, "violation")
    kept = read_cursor(cursor)
    assert kept is not None
    assert kept.kinds == ("violation",), "the rest was passed over"
    receiver.up()
    relayed(cursor, Farm(driver, (clock := Clock())).connect, receiver, clock)
    assert receiver.taken == events


def test_a_receiver_that_stays_away_after_the_end_is_given_up_and_gone_on_with(tmp_path: Path) -> None:
    driver, events = flown(tmp_path / "run")
    cursor, clock, receiver = tmp_path / "c.json", Clock(), Receiver(is_up=False)
    farm = Farm(driver, clock)
    with pytest.raises(Unavailable, match=f"{len(events)} events after number 0 wait in {waiting_file(cursor)}"):
        relayed(cursor, farm.connect, receiver, clock)
    assert RECEIVER_S <= clock.now_s < RECEIVER_S + 10.0
    with pytest.raises(Unavailable, match="the receiver took nothing"):
        relayed(cursor, gone, receiver, Clock())
    receiver.up()
    relayed(cursor, gone, receiver, Clock())
    assert receiver.taken == events
    assert not waiting_file(cursor).exists()
