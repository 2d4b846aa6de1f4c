"""A strategy that fails everywhere ends the campaign; mutators that fail where others are there do not."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import pytest
from books_drive import Driver, MemoryStore, new_books

from saflite.campaign.lifecycle.proposals import MUTATE_FAILURES_MAX, MUTATE_LOSSES_MAX
from saflite.campaign.scheduling.dispatch import ELSEWHERE_MAX
from saflite.contract.control import Control
from saflite.contract.events import CampaignChanged
from saflite.contract.join import Join
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Failure, HandedBack, Lease, MutateResult, MutateWork, Stage

STAGES: tuple[Stage, ...] = ("mutate", "score", "fly", "judge", "record")

Fails = Callable[[Driver, str, Lease], None]


def raises(driver: Driver, worker: str, lease: Lease) -> None:
    """Say that the strategy raised."""
    driver.report(lease, Failure(message="no"), worker)


def talks_nonsense(driver: Driver, worker: str, lease: Lease) -> None:
    """Answer for another round."""
    assert driver.report(lease, MutateResult(round=999, test_cases=()), worker).status == "refused"


def vanishes(driver: Driver, worker: str, _: Lease) -> None:
    """Be gone with the work."""
    driver.books.absent(worker, "mutate", driver.now)
    driver.commit()


FLIGHTS_BEFORE = 4
"""What the first two rounds of the books here fly: three and one."""


def half_a_second_later(driver: Driver) -> None:
    driver.now += 0.5
    driver.books.tick(driver.now)
    assert driver.now < 2_000.0, "the honest one is never asked"


def assert_all_was_flown(driver: Driver, failed: int) -> None:
    status = driver.books.status(driver.now)
    assert (status.flights, status.trouble) == (20, "")
    assert failed >= MUTATE_FAILURES_MAX


ALL = pytest.mark.parametrize("fails", [raises, talks_nonsense, vanishes])


@ALL
@pytest.mark.parametrize("names", ["one", "a new one each time"])
def test_who_fails_beside_another_mutator_ends_nothing(fails: Fails, names: str) -> None:
    driver, failed = new_books(20), 0
    for lease in driver.ask("mutate", "rogue-0"):
        assert not driver.ask("mutate", "a"), "it has come, and there is nothing for it yet"
        fails(driver, "rogue-0", lease)
        failed += 1
    while not driver.books.ended:
        for stage in STAGES:
            for _ in range(20):  # it asks at once, before whoever waits is given anything
                worker = f"rogue-{failed if names != 'one' else 0}"
                for lease in driver.ask("mutate", worker):
                    fails(driver, worker, lease)
                    failed += 1
                driver.now += 0.001
            driver.do(stage, many=2)
        half_a_second_later(driver)
    assert_all_was_flown(driver, failed)


def hands_back_first(driver: Driver, worker: str, lease: Lease) -> None:
    """Take it and give it back until it is kept for nobody, then fail."""
    if lease.epoch <= ELSEWHERE_MAX:
        driver.report(lease, HandedBack(), worker)
    else:
        driver.report(lease, Failure(message="no"), worker)


@pytest.mark.parametrize("fails", [raises, talks_nonsense, vanishes, hands_back_first])
@pytest.mark.parametrize("lost", [0, 1])
def test_who_has_a_key_ends_nothing_by_any_number_of_names(fails: Fails, lost: int) -> None:
    """Eleven names were enough: after ten attempts work was kept for nobody, and every failure counted."""
    driver, failed, left = new_books(20), 0, lost
    while not driver.books.ended:
        for stage in STAGES:
            for _ in range(40):
                worker = f"eve-{failed}"
                card = Join(protocol=PROTOCOL, worker=worker, stage="mutate")
                driver.books.join(card, driver.now, owner="eve")
                for lease in driver.ask("mutate", worker):
                    fails(driver, worker, lease)
                    failed += 1
                driver.now += 0.001
            for lease in driver.ask("mutate") if left and driver.now > 1.0 else ():
                left -= 1
                driver.report(lease, Failure(message="killed"))
            if stage != "mutate" or driver.now > 1.0:  # those who are there first have a second
                driver.do(stage, many=2)
        half_a_second_later(driver)
    assert_all_was_flown(driver, failed)


@ALL
@pytest.mark.parametrize("owners", [("a", "b"), ("a", "b", "c"), ("", "a", "b"), ("a", "a", "b")])
@pytest.mark.parametrize("failures", [1, 1_000])
def test_mutators_of_several_keys_that_all_failed_wait_for_none_of_each_other(
    fails: Fails, owners: tuple[str, ...], failures: int
) -> None:
    """Of two keys that had failed once each was kept from a round for the other, for ever."""
    driver, failed = new_books(20), [0] * len(owners)
    while not driver.books.ended:
        for number, owner in enumerate(owners):
            worker = f"m{number}"
            driver.books.join(Join(protocol=PROTOCOL, worker=worker, stage="mutate"), driver.now, owner=owner)
            for lease in driver.ask("mutate", worker):
                if failed[number] < failures:
                    failed[number] += 1
                    fails(driver, worker, lease)
                else:
                    driver.report(lease, driver.service.do(lease.work), worker)
        for stage in STAGES[1:]:
            driver.do(stage, many=3)
        driver.now += 0.5
        driver.books.tick(driver.now)
        assert driver.now < 2_000.0, "it is asked no more"
    assert (driver.books.status(driver.now).flights == 20) == (failures == 1)
    assert sum(failed) < 100


@ALL
@pytest.mark.parametrize("mutators", [1, 3])
def test_a_strategy_that_fails_everywhere_ends_the_campaign_soon(fails: Fails, mutators: int) -> None:
    driver, failed = new_books(20), 0
    while not driver.books.ended:
        for number in range(mutators):
            for lease in driver.ask("mutate", f"m{number}"):
                for other in range(mutators):
                    driver.ask("mutate", f"m{other}")
                fails(driver, f"m{number}", lease)
                failed += 1
        driver.now += 0.5
        assert failed < 100, "it is asked for ever"
    most = MUTATE_LOSSES_MAX if fails is vanishes else MUTATE_FAILURES_MAX
    assert failed == most + mutators - 1, "each of the others tried it once before it counted"
    assert driver.store is not None
    assert driver.store.rebuild().status(driver.now).state == "ended", "a replay comes to another end"


def _until_it_fails(fails: Fails) -> Driver:
    """Return books of which the strategy has failed for good, from its third round on, and flights are left to fly."""
    driver = new_books(40, lag=3)
    attempts = 0
    while not driver.books._core.failed:
        for lease in driver.ask("mutate", "m"):
            assert isinstance(lease.work, MutateWork)
            if lease.work.round < 2 or not lease.work.count:
                driver.report(lease, driver.service.do(lease.work), "m")
                continue
            fails(driver, "m", lease)
            attempts += 1
        driver.do("score", many=9)
        driver.now += 0.5
        assert attempts < 100, "it is asked for ever"
    assert driver.books._core.trials, "nothing is under way"
    return driver


def _finish(driver: Driver) -> tuple[int, list[CampaignChanged]]:
    """Return the flights at the end, reached without a mutator, and how the campaign changed up to there."""
    while not driver.books.ended:
        for stage in STAGES[1:]:
            driver.do(stage, many=3)
        assert not driver.ask("mutate", "m"), "a strategy that failed is asked again"
        driver.now += 0.5
        driver.books.tick(driver.now)
        assert driver.now < 2_000.0, "it does not end"
    assert not driver.books._core.trials
    assert driver.store is not None
    events = cast(MemoryStore, driver.store).all_events
    return driver.books.status(driver.now).flights, [e.fact for e in events if isinstance(e.fact, CampaignChanged)]


@ALL
def test_what_was_chosen_before_a_strategy_failed_is_flown_and_then_the_reason_is_told(fails: Fails) -> None:
    flights, changes = _finish(_until_it_fails(fails))
    assert flights == FLIGHTS_BEFORE
    assert [change.state for change in changes] == ["running", "ended"]
    assert "the strategy 'random_boxes'" in changes[-1].why
    assert changes[-1].failed


@pytest.mark.parametrize("ends", ["killed", "stopped", "paused"])
def test_a_campaign_taken_up_again_after_its_strategy_failed_ends_alike(ends: str) -> None:
    driver = _until_it_fails(raises)
    if ends == "stopped":
        assert driver.books.control(Control(verb="stop"), driver.now).accepted
    elif ends == "paused":
        assert driver.books.control(Control(verb="pause"), driver.now).accepted
        for stage in STAGES:
            driver.do(stage, many=9)
        assert not driver.books.ended
    driver.commit()
    assert driver.store is not None
    again = Driver(driver.store.rebuild(), driver.store)
    again.service = driver.service
    if ends == "paused":
        assert again.books.control(Control(verb="resume"), again.now).accepted
        for _ in range(MUTATE_FAILURES_MAX):  # an order to go on asks it anew
            (lease,) = again.ask("mutate", "m")
            raises(again, "m", lease)
    flights, changes = _finish(again)
    assert flights == FLIGHTS_BEFORE
    assert changes[-1] == CampaignChanged(
        state="ended", why="the strategy 'random_boxes' cannot propose: no", failed=True
    )


def test_a_strategy_mended_after_it_failed_goes_on_where_it_would_have_been() -> None:
    mended = _until_it_fails(raises)
    _finish(mended)
    assert mended.books.control(Control(verb="budget", number=40), mended.now).accepted
    mended.commit()
    (lease,) = mended.ask("mutate", "m")
    raises(mended, "m", lease)
    assert not mended.books.ended, "it is tried as often as at first"
    mended.run()
    never_failed = new_books(40, lag=3)
    never_failed.run()
    assert mended.books._core.flown == never_failed.books._core.flown
