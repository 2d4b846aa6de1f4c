"""A strategy that fails everywhere ends the campaign; mutators that fail where others are there do not."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from books_drive import Driver, new_books

from saflite.campaign.lifecycle.proposals import MUTATE_FAILURES_MAX, MUTATE_LOSSES_MAX
from saflite.contract.work import Failure, Lease, MutateResult, Stage

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
        driver.now += 0.5
        driver.books.tick(driver.now)
        assert driver.now < 2_000.0, "the honest one is never asked"
    status = driver.books.status(driver.now)
    assert (status.flights, status.trouble) == (20, "")
    assert failed >= MUTATE_FAILURES_MAX


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
