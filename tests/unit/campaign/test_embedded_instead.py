"""A batch that the scorer's process is lost with is scored by the embedded scorer, counted; only then by nobody."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from books_drive import Driver, MemoryStore, doubles, new_books
from msgspec.structs import replace

from saflite.campaign.lifecycle.proposals import EMBEDDED_FAULTS_MAX, SCORE_FAULTS_MAX
from saflite.campaign.scheduling.work_keys import ScoreKey
from saflite.campaign.storage.store import Store
from saflite.console.run_data.run_folder import open_run
from saflite.console.view import event_lines, live
from saflite.contract.control import Control
from saflite.contract.events import Scored
from saflite.contract.score import EMBEDDED
from saflite.contract.work import Failure, HandedBack, Heartbeat, Lease, ScoreResult, ScoreWork


def fails(driver: Driver, lease: Lease, worker: str) -> None:
    assert driver.report(lease, Failure(message="it broke"), worker).status == "accepted"


def is_rejected(driver: Driver, lease: Lease, worker: str) -> None:
    given = driver.service.do(lease.work)
    assert isinstance(given, ScoreResult)
    changed = tuple(replace(one, test_case="0" * 16) for one in given.scores)
    assert driver.report(lease, replace(given, scores=changed), worker).status == "refused"


def vanishes(driver: Driver, lease: Lease, worker: str) -> None:
    driver.books.absent(worker, "score", driver.now)
    driver.commit()


def hangs(driver: Driver, lease: Lease, worker: str) -> None:
    deadline = driver.books._leases.deadline(ScoreKey(0, 0))
    assert deadline is not None
    while driver.now < deadline.overdue_s:  # it looks alive all the time
        driver.now += 2.0
        beat = Heartbeat(worker=worker, stage="score", leases=((lease.lease_id, lease.epoch),))
        driver.books.beat(beat, driver.now)
        driver.books.tick(driver.now)
    driver.commit()


def is_away_while_the_books_stand_still(driver: Driver, lease: Lease, worker: str) -> None:
    beat = Heartbeat(worker=worker, stage="score", leases=((lease.lease_id, lease.epoch),))
    driver.books.beat(beat, driver.now)
    driver.now += 100_000.0  # a machine that was suspended, a stopped process
    driver.books.tick(driver.now)
    driver.commit()


WAYS = (fails, is_rejected, vanishes)
Lose = Callable[[Driver, Lease, str], None]


def lost(driver: Driver, *ways: Lose) -> ScoreWork:
    """Lose a batch in these ways, each time with another worker; return the work that follows, lent to nobody yet."""
    for number, way in enumerate(ways):
        (lease,) = driver.ask("score", f"score-{number}")
        way(driver, lease, f"score-{number}")
    (lease,) = driver.ask("score", "next")
    assert driver.report(lease, HandedBack(message=""), "next").status == "accepted"
    assert isinstance(lease.work, ScoreWork)
    return lease.work


def proposed(driver: Driver) -> Driver:
    assert driver.books.control(Control(verb="shadow", text="watcher"), driver.now).accepted
    driver.do("score")
    driver.do("mutate")
    return driver


def scored(driver: Driver) -> list[Scored]:
    store: object = driver.store
    assert isinstance(store, MemoryStore)
    return [event.fact for event in store.all_events if isinstance(event.fact, Scored)]


@pytest.mark.parametrize("first", WAYS)
@pytest.mark.parametrize("second", WAYS)
def test_the_embedded_scorer_answers_what_was_lost_twice_however(first: Lose, second: Lose) -> None:
    asked = lost(proposed(new_books()))
    driver = proposed(new_books())
    work = lost(driver, first, second)
    assert (work.model, work.shadow) == (EMBEDDED, ()), "one that only watches may be what the process died of"
    assert replace(work, model=asked.model, shadow=asked.shadow) == asked
    driver.do("score", "next")
    status, count = driver.books.status(driver.now), len(work.test_cases)
    assert (status.fallbacks, status.unscored, status.scores, status.scores_by_model) == (count, 0, count, 0)
    (fact,) = scored(driver)
    values = {one.test_case: one.value for one in driver.service.do(work).scores}  # type: ignore[union-attr]
    assert (fact.model, fact.fallbacks, fact.unscored, dict(fact.scores)) == ("scripted", count, 0, values)


def test_a_scorer_that_hangs_costs_one_lease() -> None:
    for ways in ((hangs,), (fails, hangs)):
        driver = proposed(new_books())
        work = lost(driver, *ways)
        assert (work.model, work.shadow) == (EMBEDDED, ())
        driver.do("score", "next")
        status = driver.books.status(driver.now)
        assert (status.fallbacks, status.unscored) == (len(work.test_cases), 0)


def test_even_the_embedded_scorer_that_hangs_is_asked_again_and_not_for_ever() -> None:
    driver = proposed(new_books())
    lost(driver, *[hangs] * EMBEDDED_FAULTS_MAX)
    (lease,) = driver.ask("score", "last")
    hangs(driver, lease, "last")
    assert driver.books.status(driver.now).unscored == len(lease.work.test_cases)  # type: ignore[union-attr]


def test_once_lost_the_scorer_itself_is_asked_again() -> None:
    for way in WAYS:
        asked = lost(proposed(new_books()))
        assert lost(proposed(new_books()), way) == asked


def test_what_the_scorer_says_too_late_does_not_count() -> None:
    driver = proposed(new_books())
    (first,) = driver.ask("score", "late")
    late = driver.service.do(first.work)
    vanishes(driver, first, "late")
    lost(driver, fails)
    assert driver.report(first, late, "late").status == "refused"
    driver.do("score", "next")
    assert driver.books.status(driver.now).scores_by_model == 0


def test_the_embedded_scorer_that_was_asked_for_is_no_fallback() -> None:
    driver = new_books()
    assert driver.books.control(Control(verb="scorer", text=EMBEDDED), driver.now).accepted
    driver.do("score")
    driver.do("mutate")
    lost(driver, vanishes, vanishes)
    driver.do("score", "next")
    status = driver.books.status(driver.now)
    assert status.fallbacks == 0
    assert status.scores == status.scores_by_model > 0


def test_what_even_the_embedded_scorer_is_lost_with_is_told_as_not_scored() -> None:
    driver = proposed(new_books())
    work = lost(driver, *[vanishes] * (SCORE_FAULTS_MAX + EMBEDDED_FAULTS_MAX - 1))
    (lease,) = driver.ask("score", "last")
    fails(driver, lease, "last")
    status = driver.books.status(driver.now)
    assert status.unscored == status.fallbacks == len(work.test_cases)
    assert f"{status.unscored} test cases were not scored: it broke" in live.one_line(status)
    assert "embedded" not in live.one_line(status)
    (fact,) = scored(driver)
    assert event_lines._scored(fact).endswith(f", {status.unscored} test cases were not scored")


def test_who_is_asked_stays_so_when_a_campaign_is_taken_up_again(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(20), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.do("mutate")
    work = lost(driver, fails, vanishes)
    store.keep(driver.books.snapshot())
    store.close()
    for _ in range(2):  # out of the snapshot, then out of the journal alone
        store = Store.open(tmp_path / "run")
        driver = Driver(store.rebuild(), store)
        assert lost(driver).model == work.model == EMBEDDED
        store.close()
        for path in (tmp_path / "run").glob("snapshot*"):
            path.unlink()
    store = Store.open(tmp_path / "run")
    driver = Driver(store.rebuild(), store)
    driver.do("score", "next")
    store.close()
    with open_run(tmp_path / "run") as run:
        found = run.fallbacks()
        assert (found.embedded, found.unscored) == (len(work.test_cases), 0)
        assert found.in_words().startswith(f"{found.embedded} scores by the embedded scorer instead: ")
        assert {(row.model, row.scored_by) for row in run.scores()} == {("scripted", EMBEDDED)}


def test_a_scorer_is_not_blamed_for_the_time_in_which_the_books_stood_still() -> None:
    driver = proposed(new_books())
    assert lost(driver, is_away_while_the_books_stand_still).model != EMBEDDED
    assert lost(proposed(new_books()), hangs).model == EMBEDDED
