"""A strategy that hangs, or takes its process down, each time is told of; in the end the campaign is over."""

from __future__ import annotations

import pytest
from books_drive import Driver, new_books

from saflite.campaign.lifecycle.proposals import MUTATE_LOSSES_MAX
from saflite.campaign.scheduling.tasks import Task
from saflite.contract.work import MutateWork


def _vanishes(driver: Driver, worker: str) -> None:
    """Let a mutator take the work and be gone with it."""
    assert driver.ask("mutate", worker), "nothing to propose"
    driver.books.absent(worker, "mutate", driver.now)
    driver.commit()


def _hangs(driver: Driver, worker: str) -> None:
    """Let a mutator take the work and never come to an end."""
    assert driver.ask("mutate", worker), "nothing to propose"
    driver.now += 400.0
    driver.books.tick(driver.now)
    driver.commit()


def _losses(driver: Driver) -> int:
    tasks: list[Task] = [task for task in driver.books._core.tasks if task.stage == "mutate"]
    return tasks[0].losses


@pytest.mark.parametrize("loses", [_vanishes, _hangs])
def test_a_strategy_that_is_always_lost_is_told_of_and_ends_the_campaign(loses: object) -> None:
    assert callable(loses)
    driver = new_books(20)
    for attempt in range(100):
        if driver.books.ended:
            break
        loses(driver, f"m{attempt % 2}")
        told = driver.books.status(driver.now).trouble
        assert ("times in a row" in told) == (1 < _losses(driver) < MUTATE_LOSSES_MAX), told
    assert driver.books.ended, "it is asked for ever"
    assert _losses(driver) == MUTATE_LOSSES_MAX
    assert driver.store is not None
    assert driver.store.rebuild().status(driver.now).state == "ended", "a replay comes to another end"


def test_mutators_killed_now_and_then_end_nothing() -> None:
    driver = new_books(80)
    killed = 0
    while not driver.books.ended:
        for number in range(MUTATE_LOSSES_MAX - 1):
            if driver.ask("mutate", f"m{number}"):
                driver.books.absent(f"m{number}", "mutate", driver.now)
                driver.commit()
                killed += 1
        for stage in ("mutate", "score", "fly", "judge", "record"):
            driver.do(stage, many=9)
        driver.now += 0.5
        driver.books.tick(driver.now)
    status = driver.books.status(driver.now)
    assert killed > 3 * MUTATE_LOSSES_MAX
    assert (status.flights, status.trouble) == (80, "")


def test_an_attempt_that_told_outcomes_to_its_end_is_no_loss_in_a_row() -> None:
    driver = new_books(40)
    driver.run(until_flights=15)
    (lease,) = driver.wait_for("mutate", "fresh", cursor=-1)
    assert isinstance(lease.work, MutateWork)
    driver.books.absent("fresh", "mutate", driver.now)
    driver.commit()
    task = next(task for task in driver.books._core.tasks if task.stage == "mutate")
    assert task.losses == 1
    (again,) = driver.ask("mutate", "b", cursor=-1)
    task.catching_up = True  # as where there is more to tell than goes into one message
    driver.report(again, driver.service.do(again.work), "b")
    assert task.losses == 0
