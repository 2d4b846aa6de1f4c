"""Events whose commits were lost give their numbers to others: a bridge tells these, too, under ids of their own."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import pytest

from saflite.campaign.storage.store import Store
from saflite.campaign.storage.witness import accept_loss, loss
from saflite.console.operations import bridging
from saflite.console.run_data.run_folder import open_run
from saflite.contract.cloud_event import cloud_event
from saflite.contract.events import Event
from saflite.runtime.webhook import Cursor

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles


class _Receiver:
    """Takes events as a receiver does that drops doubles by id."""

    def __init__(self) -> None:
        self.taken: dict[str, Event] = {}
        self.posted = 0

    def deliver(self, event: Event, cursor: Cursor) -> None:
        self.posted += 1
        self.taken[cloud_event(event, cursor.campaign, f"{cursor.campaign}-{cursor.begun_unix_s:.0f}").id] = event

    def close(self) -> None:
        pass


@pytest.mark.parametrize("until", [9, 10**9], ids=["fewer-than-told", "more-than-told"])
def test_all_that_stands_in_the_books_is_told_after_a_loss(tmp_path: Path, until: int) -> None:
    run, old = tmp_path / "run", tmp_path / "old.sqlite"
    store = Store.create(run, doubles.campaign(30), doubles.TEMPLATE, doubles.TARGET)
    Driver(store.rebuild(), store).run(until_flights=8)
    store.close()
    shutil.copy(run / "books.sqlite", old)
    store = Store.open(run)
    Driver(store.rebuild(), store).run(until_flights=16)
    store.close()
    receiver = _Receiver()
    bridge = bridging.Bridge(frozenset(), receiver, tmp_path / "cursor.json")  # type: ignore[arg-type]
    args = argparse.Namespace(run=run, connect="", cursor=None, webhook="http://127.0.0.1:9/x", kind=[])
    bridging._carry(args, bridge)
    bridging._carry(args, bridge)
    before = receiver.posted
    assert before == len(receiver.taken), "told again without a loss"
    shutil.copy(old, run / "books.sqlite")
    (run / "books.snapshot").unlink(missing_ok=True)
    assert loss(run)
    accept_loss(run)
    store = Store.open(run)
    Driver(store.rebuild(), store).run(workers=("c",), until_flights=until)
    store.close()
    with open_run(run) as folder:
        stands = list(folder.events(1))
    assert (len(stands) < before) == (until == 9)
    bridging._carry(args, bridge)
    untold = [event.seq for event in stands if event not in receiver.taken.values()]
    assert untold == []
    posted = receiver.posted
    bridging._carry(args, bridge)
    assert receiver.posted == posted, "told again without a loss"
