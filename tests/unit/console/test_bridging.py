"""A bridge to a webhook comes to its end with the campaign, and leaves out nothing of the kinds it is asked for."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from saflite.campaign.storage.store import Store
from saflite.console.cli import REFUSED, main
from saflite.console.operations import bridging
from saflite.console.operations.relaying import PatientClock
from saflite.console.run_data.run_folder import open_run
from saflite.contract import wire
from saflite.contract.cloud_event import CloudEvent
from saflite.contract.control import Control
from saflite.contract.errors import Unavailable
from saflite.contract.events import KINDS, Event, kind_of
from saflite.runtime.webhook import Cursor, Webhook

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles


class _Receiver:
    """Takes what is posted to it."""

    def __init__(self) -> None:
        self.taken: list[Event] = []

    def deliver(self, event: Event, cursor: Cursor) -> None:
        assert event.seq > cursor.seq
        self.taken.append(event)

    def close(self) -> None:
        pass


def carried(run: Path, *kinds: str) -> tuple[bool, list[Event]]:
    """Have a bridge that begins now carry what there is; whether it has come to its end, and what was told."""
    receiver = _Receiver()
    bridge = bridging.Bridge(frozenset(kinds), receiver, run / "cursor.json")  # type: ignore[arg-type]
    args = argparse.Namespace(run=run, connect="", cursor=None, webhook="http://127.0.0.1:9/x", kind=list(kinds))
    return bridging._carry(args, bridge), receiver.taken


def flown(run: Path, *, stopped_after: int = 10**9) -> Driver:
    """Fly a campaign of 12 flights, or some of it."""
    store = Store.create(run, doubles.campaign(12), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=stopped_after)
    return driver


def closed(driver: Driver) -> None:
    """Close the books."""
    driver.commit()
    assert driver.store is not None
    driver.store.close()


@pytest.mark.parametrize("kinds", [(), ("violation",), ("campaign",), ("fault",)])
@pytest.mark.parametrize("leaves", [False, True])
def test_a_bridge_begun_again_on_a_run_that_has_ended_and_was_told_ends(
    kinds: tuple[str, ...], leaves: bool, tmp_path: Path
) -> None:
    driver = flown(tmp_path / "run")
    if leaves:  # what comes after the end is no reason to wait
        driver.books.absent("a", "fly", driver.now, why="the farm has ended")
    closed(driver)
    with open_run(tmp_path / "run") as folder:
        wanted = [event for event in folder.events() if not kinds or kind_of(event.fact) in kinds]
    assert carried(tmp_path / "run", *kinds) == (True, wanted)
    assert carried(tmp_path / "run", *kinds) == (True, [])


def test_a_run_that_goes_on_later_is_waited_for(tmp_path: Path) -> None:
    """One that was killed has not ended, nor has one that ended once, was taken up again, and was killed then."""
    run = tmp_path / "run"
    driver = flown(run, stopped_after=4)
    closed(driver)
    assert not carried(run)[0]
    store = Store.open(run)
    driver = Driver(store.rebuild(), store)
    assert driver.books.control(Control(verb="stop"), driver.now).accepted
    closed(driver)
    assert carried(run)[0]
    store = Store.open(run)
    closed(Driver(store.rebuild(), store))
    assert not carried(run)[0]
    assert not carried(run)[0]


def test_no_event_of_a_kind_that_is_asked_for_later_is_left_out(tmp_path: Path) -> None:
    """How far a bridge is says nothing of kinds that it did not tell; fewer kinds than it told go on where it was."""
    run = tmp_path / "run"
    closed(flown(run))
    with open_run(run) as folder:
        events = list(folder.events())
    of = {word: [event for event in events if kind_of(event.fact) == word] for word in KINDS}
    assert of["violation"]
    assert carried(run, "violation") == (True, of["violation"])
    assert carried(run, "flown") == (True, of["flown"])
    both = [event for event in events if kind_of(event.fact) in ("flown", "violation")]
    assert carried(run, "violation", "flown") == (True, both)
    assert carried(run, "flown") == carried(run, "flown") == (True, [])
    assert carried(run) == (True, events)
    assert carried(run, "violation") == carried(run, "judged") == (True, []), "all of it was told"


def test_kinds_that_differ_from_those_told_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    closed(flown(run))
    monkeypatch.setattr(bridging, "Webhook", lambda *_: _Receiver())
    for kind, said in (
        ("violation", ""),
        ("violation", "going on after event"),
        ("flown", "only violation was told before"),
    ):
        assert main(["watch", str(run), "--kind", kind, "--webhook", "http://127.0.0.1:9/x"]) == 0
        shown = capsys.readouterr().out
        assert said in shown if said else not shown


class _Clock:
    """Virtual seconds; `on_sleep` is called at each wait."""

    def __init__(self, on_sleep: Callable[[float], None] = lambda _: None) -> None:
        self.now_s, self._on_sleep = 0.0, on_sleep

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return self.now_s

    def sleep_s(self, duration_s: float) -> None:
        self.now_s += duration_s
        self._on_sleep(self.now_s)


def _from_run(run: Path, clock: _Clock, answers: Callable[[Event], int], patience_s: float, *kinds: str) -> list[Event]:
    """Have a bridge carry to its end; what was taken. `answers` says what the receiver does with an event."""
    taken: list[Event] = []

    def receive(request: httpx.Request) -> httpx.Response:
        event = wire.unpack_json(request.content, CloudEvent).data
        if (code := answers(event)) == 204:
            taken.append(event)
        return httpx.Response(code)

    cursor = run / "cursor.json"
    patient = PatientClock(clock, lambda: bridging._taken_at_end(run, cursor), patience_s)
    webhook = Webhook("http://127.0.0.1:9/x", patient, b"", httpx.MockTransport(receive))
    args = argparse.Namespace(run=run, connect="", cursor=cursor, webhook="http://127.0.0.1:9/x", kind=list(kinds))
    try:
        bridging._from_run(args, bridging.Bridge(frozenset(kinds), webhook, cursor, patience_s), clock, lambda _: None)
    except Unavailable as fault:
        return [*taken, fault]  # type: ignore[list-item]
    finally:
        webhook.close()
    return taken


@pytest.mark.parametrize("kinds", [(), ("violation",)])
@pytest.mark.parametrize("takes", [0, 3])
def test_a_receiver_that_stays_away_after_the_end_is_given_up_and_gone_on_with(
    kinds: tuple[str, ...], takes: int, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    closed(flown(run))
    with open_run(run) as folder:
        wanted = [event for event in folder.events() if not kinds or kind_of(event.fact) in kinds]
    takes = min(takes, len(wanted) - 1)
    there = [event.seq for event in wanted[:takes]]
    clock = _Clock()
    *taken, fault = _from_run(run, clock, lambda event: 204 if event.seq in there else 503, 100.0, *kinds)
    assert taken == wanted[:takes]
    assert clock.now_s == pytest.approx(100.0), "no try is waited for longer than patience lasts"
    count = len(wanted) - takes
    events = "1 event" if count == 1 else f"{count} events"
    assert f"{events} after number {([0, *there])[-1]} stay in {run}" in str(fault)
    assert _from_run(run, _Clock(), lambda _: 204, 100.0, *kinds) == wanted[takes:], "the same command goes on"


def test_a_receiver_is_waited_for_as_long_as_the_campaign_goes_on_and_while_it_takes_some(tmp_path: Path) -> None:
    run = tmp_path / "run"
    driver = flown(run, stopped_after=4)
    closed(driver)

    def ends(now_s: float) -> None:
        if now_s < 10_000.0 or open_run(run).standing().state == "ended":
            return
        store = Store.open(run)
        again = Driver(store.rebuild(), store)
        assert again.books.control(Control(verb="stop"), again.now).accepted
        closed(again)

    clock = _Clock(ends)
    last: dict[int, float] = {}

    def slow(event: Event) -> int:
        """Take nothing before the campaign has ended, and each event 90 s after it came first then."""
        if clock.now_s < 10_000.0:
            return 503
        return 204 if clock.now_s >= last.setdefault(event.seq, clock.now_s) + 90.0 else 503

    taken = _from_run(run, clock, slow, 100.0)
    with open_run(run) as folder:
        assert taken == list(folder.events())


@pytest.mark.parametrize("value", ["-1", "nan"])
def test_a_patience_that_is_none_is_refused(value: str, tmp_path: Path) -> None:
    words = ["watch", str(tmp_path), "--webhook", "http://127.0.0.1:9/x", "--receiver-patience", value]
    assert main(words) == REFUSED
