"""Taking a run up again: refused in one line where nobody here could fly what it flies."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
import pytest

from saflite.bus.base import Inbox, Reply
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.console.run_data.run_folder import open_run
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.control import Control
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import DEFAULT_TARGET, StartState
from saflite.runtime.campaign_runner import NEVER, Follower, _work, check_build, interrupts, resume
from saflite.runtime.client import FarmClient
from saflite.runtime.farm import LocalFarm, roles_of
from saflite.simulator_worker.registry import describe_target

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import new_books

OTHER = "0123456789abcdef" * 4


def journal(run_dir: Path) -> list[bytes]:
    """Return what the books of a run have noted, which is theirs to open again."""
    store = Store.open(run_dir)
    lines = list(store.journal())
    store.close()
    return lines


def run_on(build: str, run_dir: Path, *, target: str = DEFAULT_TARGET, order: str = "", budget: int = 3) -> Path:
    """Make a run on a build of the reference; `order` is given to its books."""
    info = msgspec.structs.replace(describe_target(DEFAULT_TARGET), name=target, build=build)
    campaign = Campaign(name="other-build", budget_flights=budget, start=StartState())
    campaign = msgspec.structs.replace(campaign, target=msgspec.structs.replace(campaign.target, name=target))
    store = Store.create(run_dir, campaign, template(campaign, build), info)
    books = store.rebuild()
    books.begin(0.0, 1.7e9)
    if order:
        assert books.control(Control(verb=order, number=0), 0.0).accepted  # type: ignore[arg-type]
    store.commit(books.drain())
    store.close()
    return run_dir


@pytest.mark.parametrize(("order", "budget"), [("", None), ("stop", None), ("", 5)])
def test_a_run_of_another_build_is_refused_before_anything_starts(
    order: str, budget: int | None, tmp_path: Path
) -> None:
    run_dir = run_on(OTHER, tmp_path / "run", order=order)
    before = journal(run_dir)
    with pytest.raises(Refused) as refused:
        resume(run_dir, simulators=1, budget=budget)
    words = str(refused.value)
    assert OTHER[:12] in words
    assert describe_target(DEFAULT_TARGET).build[:12] in words
    assert "--workers 0" in words
    assert journal(run_dir) == before


@pytest.mark.parametrize("case", ["same", "any", "over", "elsewhere", "unknown"])
def test_others_are_not(case: str, tmp_path: Path) -> None:
    build = {"same": describe_target(DEFAULT_TARGET).build, "any": ""}.get(case, OTHER)
    target = "known-elsewhere" if case == "unknown" else DEFAULT_TARGET
    run_dir = run_on(build, tmp_path / "run", target=target, budget=0 if case == "over" else 3)
    check_build(run_dir, flies_here=case != "elsewhere", goes_on=False)


class _Breaks(LocalFarm):
    """A farm of which all workers of a stage break again and again."""

    def start(self) -> None:
        """Begin."""

    def poll(self) -> None:
        """Break."""
        raise Unavailable("score breaks again and again, 5 times so far")


def test_why_a_farm_broke_stands_in_its_folder(tmp_path: Path) -> None:
    run_dir = run_on("", tmp_path / "run")
    with pytest.raises(Unavailable, match="again and again"):
        _work(_Breaks("other-build", run_dir, roles_of({})), None, NEVER)
    with open_run(run_dir) as run:
        now = run.standing()
        assert now.failed
        assert now.text == "not running: score breaks again and again, 5 times so far"
        assert run.summary().failed == now.why


class _Books:
    """A link to books, on which each question is met with the next of some replies."""

    def __init__(self, *replies: Reply) -> None:
        self._replies = list(replies)

    def ask(self, _key: str, _payload: bytes, tag: Any, inbox: Inbox, _timeout_s: float) -> None:
        inbox(self._replies.pop(0)._replace(tag=tag))

    def close(self) -> None:
        pass


def test_a_status_that_cannot_be_read_is_told_of_once_and_asked_for_again(caplog: pytest.LogCaptureFixture) -> None:
    driver = new_books(4)
    whole = wire.encode(driver.books.control(Control(verb="status"), driver.now))
    too_long, readable = Reply(0, b" " * (wire.MESSAGE_BYTES_MAX + 1)), Reply(0, whole)
    books = _Books(too_long, too_long, Reply(0, None, "not so"), readable, too_long)
    follower = Follower(lambda: FarmClient(books, "night"))  # type: ignore[arg-type]
    heard = [follower.status() for _ in range(5)]
    assert [one is not None for one in heard] == [False, False, False, True, False]
    told = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert ["not so" in words for words in told] == [False, True, False]
    follower.close()


def test_a_farm_runs_in_another_thread_than_the_first_as_from_a_notebook() -> None:
    def noted() -> list[str]:
        with interrupts() as found:
            return found

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(noted).result() == []
