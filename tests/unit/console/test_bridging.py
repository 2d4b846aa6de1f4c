"""A bridge to a webhook comes to its end with the campaign, and leaves out nothing of the kinds it is asked for."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pytest

from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.operations import bridging
from saflite.console.run_data.run_folder import open_run
from saflite.contract.control import Control
from saflite.contract.events import KINDS, Event, kind_of
from saflite.runtime.webhook import Cursor

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
