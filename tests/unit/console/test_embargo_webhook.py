"""A webhook is told no more of a find than a report shows: any flight of its test case may make it private."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import httpx
import pytest
from bridge_doubles import Clock, DiesWhenFlownFor, Farm, Receiver

from saflite.campaign.storage.store import Store
from saflite.console.operations.bridging import Bridge, _carry
from saflite.console.operations.relaying import relay
from saflite.console.run_data import farm_lookup, run_folder
from saflite.console.run_data.run_folder import open_run
from saflite.contract.errors import Unavailable
from saflite.contract.events import Event, ViolationFound
from saflite.contract.flight import Purpose
from saflite.runtime import waiting_events
from saflite.runtime.client import FarmClient
from saflite.runtime.waiting_events import waiting_file
from saflite.runtime.webhook import Webhook

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

WITHHELD = "1 finding of memory safety withheld"


def driven(run_dir: Path, purpose: Purpose) -> Driver:
    """Fly a campaign whose autopilot dies of a fault of memory in flights of one purpose."""
    store = Store.create(run_dir, doubles.campaign(10), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.service = DiesWhenFlownFor(store, purpose)
    driver.run()
    return driver


def check_told(run_dir: Path, taken: list[Event], *, only_withheld: bool = False) -> None:
    """Of finds of a test case with a fault of memory it is told that there is one, of the others all."""
    with open_run(run_dir) as run:
        hidden, found = run.memory_faults(), run.violations()
    assert {one.test_case for one in found} & hidden, "nothing to keep back"
    assert all(one.behaviour for one in found)
    told = [event.fact.violation for event in taken if isinstance(event.fact, ViolationFound)]
    assert [one.test_case for one in told] == [one.test_case for one in found]
    for one, whole in zip(told, found, strict=True):
        is_private = only_withheld or one.test_case in hidden
        assert (one.message, one.behaviour) == ((WITHHELD, "") if is_private else (whole.message, whole.behaviour))


def webhook_to(receiver: Receiver, clock: Clock) -> Webhook:
    return Webhook("http://127.0.0.1:9/finds", clock, transport=httpx.MockTransport(receiver.receive))


def gone() -> FarmClient:
    raise Unavailable("nobody is there")


@pytest.mark.parametrize("purpose", ["confirm", "check"])
@pytest.mark.parametrize("is_running", [False, True])
def test_by_a_run_folder_the_books_tell_what_is_private(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, purpose: Purpose, is_running: bool
) -> None:
    driver, clock, receiver = driven(tmp_path / "run", purpose), Clock(), Receiver()
    if is_running:
        monkeypatch.setattr(farm_lookup, "says_it_runs", lambda _place: True)
        monkeypatch.setattr(farm_lookup, "connect", lambda _where: Farm(driver, clock).connect())
    args = argparse.Namespace(run=tmp_path / "run", connect="", campaign="", keys=None, insecure=False)
    webhook = webhook_to(receiver, clock)
    assert _carry(args, Bridge(frozenset({"violation"}), webhook, tmp_path / "cursor.json"))
    webhook.close()
    check_told(tmp_path / "run", receiver.taken)


@pytest.mark.parametrize("kinds", [(), ("violation",)])
def test_by_a_farm_elsewhere_its_events_tell_what_is_private(kinds: tuple[str, ...], tmp_path: Path) -> None:
    driver, clock, receiver = driven(tmp_path / "run", "confirm"), Clock(), Receiver()
    webhook = webhook_to(receiver, clock)
    relay(Farm(driver, clock).connect, Bridge(frozenset(kinds), webhook, tmp_path / "c.json"), clock, print, 30.0)
    webhook.close()
    check_told(tmp_path / "run", receiver.taken)


@pytest.mark.parametrize("is_there", [True, False])
def test_a_bridge_begun_again_knows_of_deaths_told_before_or_withholds(is_there: bool, tmp_path: Path) -> None:
    """Deaths are no kind asked for: they wait nowhere. A farm that is there is asked, without one every find counts."""
    driver, clock, receiver = driven(tmp_path / "run", "confirm"), Clock(), Receiver(is_up=False)
    left, bridge = tmp_path / "left.json", Bridge(frozenset({"violation"}), webhook_to(receiver, clock), tmp_path / "c")
    farm = Farm(driver, clock)

    def killed() -> None:
        left.write_bytes(bridge.cursor_file.read_bytes())
        waiting_file(left).write_bytes(waiting_file(bridge.cursor_file).read_bytes())
        receiver.up()

    farm.at_end = killed
    relay(farm.connect, bridge, clock, print, 30.0)
    bridge.webhook.close()
    receiver.taken.clear()
    clock = Clock()
    again = bridge._replace(cursor_file=left, webhook=webhook_to(receiver, clock))
    relay(Farm(driver, clock).connect if is_there else gone, again, clock, print, 30.0)
    again.webhook.close()
    check_told(tmp_path / "run", receiver.taken, only_withheld=not is_there)


def test_a_run_that_is_gone_on_with_while_the_receiver_is_slow_keeps_its_finds_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_folder, "EVENTS_AT_ONCE", 5)  # of a long run the events are read bit by bit
    store = Store.create(tmp_path / "run", doubles.campaign(10), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.service = DiesWhenFlownFor(store, "confirm")
    driver.run(until_flights=2)
    with open_run(tmp_path / "run") as run:
        assert not run.memory_faults()
    receiver, clock = Receiver(), Clock()

    def slow(request: httpx.Request) -> httpx.Response:
        if not receiver.taken:
            driver.run()
        return receiver.receive(request)

    webhook = Webhook("http://127.0.0.1:9/finds", clock, transport=httpx.MockTransport(slow))
    args = argparse.Namespace(run=tmp_path / "run", connect="", campaign="", keys=None, insecure=False)
    bridge = Bridge(frozenset(), webhook, tmp_path / "cursor.json")
    while not _carry(args, bridge):
        pass
    webhook.close()
    check_told(tmp_path / "run", receiver.taken)


def test_a_bridge_begun_again_on_a_full_file_asks_the_farm_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waiting_events, "BYTES_MAX", 300)
    monkeypatch.setattr(waiting_events, "TAKEN_BYTES_MAX", 100)
    driver, clock, receiver = driven(tmp_path / "run", "confirm"), Clock(), Receiver(is_up=False)
    bridge = Bridge(frozenset({"violation"}), webhook_to(receiver, clock), tmp_path / "c.json")

    def killed(words: str) -> None:
        if "is full" in words:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        relay(Farm(driver, clock).connect, bridge, clock, killed, 30.0)
    receiver.up()
    clock = Clock()
    again = bridge._replace(webhook=webhook_to(receiver, clock))
    relay(Farm(driver, clock).connect, again, clock, print, 30.0)
    again.webhook.close()
    check_told(tmp_path / "run", receiver.taken)
