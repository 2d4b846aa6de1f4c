"""Scorers learn from one window of the campaign, however late they come: what is chosen never depends on who scores."""

from __future__ import annotations

from pathlib import Path

import pytest
from books_drive import Driver, doubles

from saflite.campaign.scheduling.work_keys import run_and_key
from saflite.campaign.storage.store import Store
from saflite.contract.work import Lease, Outcome, ScoreWork
from saflite.scorer_pool.learning.history import History

MOST = 30


def _as_told_to(driver: Driver, lease: Lease, cursor: int) -> ScoreWork:
    """Return the work of a lease as a scorer gets it that was told outcomes up to `cursor`."""
    key = run_and_key(lease.lease_id)[1]
    task = None if key is None else driver.books._core.tasks.get(key)
    assert task is not None
    told = driver.books._work_messages.work(task, cursor)
    assert isinstance(told, ScoreWork)
    return told


def _learn(history: History, work: ScoreWork) -> tuple[Outcome, ...]:
    history.tell(work.recent, work.from_cursor, work.cursor)
    return history.view(work.since, work.cursor)


@pytest.mark.parametrize("most_bytes", [2**24, 8_000, 1_000], ids=["all-fit", "a-part-fits", "no-round-fits"])
def test_who_comes_late_or_idled_learns_from_the_same_outcomes_as_who_scored_from_the_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_bytes: int
) -> None:
    monkeypatch.setattr("saflite.campaign.scheduling.work_messages.RECENT_MAX", MOST)
    monkeypatch.setattr("saflite.campaign.scheduling.work_messages.TOLD_MAX_BYTES", most_bytes)
    store = Store.create(tmp_path / "run", doubles.campaign(90), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    old, idle, views = History(), History(), []
    while not driver.books.ended:
        for lease in driver.ask("score", "old", 9, cursor=old.cursor):
            work = lease.work
            assert isinstance(work, ScoreWork)
            view = _learn(old, work)
            assert view == _learn(History(), _as_told_to(driver, lease, -1)), "who comes late knows other outcomes"
            if work.round % 4 == 0:
                assert view == _learn(idle, _as_told_to(driver, lease, idle.cursor)), "who idled knows other outcomes"
            views.append(view)
            driver.report(lease, driver.service.do(work), "old")
        for stage in ("mutate", "fly", "judge", "record"):
            driver.do(stage, many=9)
        driver.now += 0.5
        driver.books.tick(driver.now)
        assert driver.now < 1e4, "the campaign does not end"
    store.close()
    assert max(map(len, views)) <= MOST
    assert views[-1][0].round > 0, "the window never moved"
    assert views[-1][-1].round >= 20


def test_work_of_an_earlier_round_after_that_of_a_later_one_is_scored_from_its_own_window() -> None:
    cases = [doubles.TEMPLATE] * 9
    told = tuple(
        Outcome(test_case=one, round=place, ending="completed", robustness=1.0) for place, one in enumerate(cases)
    )
    history = History()
    history.tell(told[5:], -1, 8)  # the later round: its window begins after round 4
    history.tell(told[3:8], -1, 7)
    assert history.view(2, 7) == told[3:8]
    assert history.view(4, 8) == told[5:]
