"""Who asks for work and gives it back, again and again, in many words: it leaves little, and comes to an end."""

from __future__ import annotations

from typing import get_args

import pytest
from books_drive import Driver, new_books

from saflite.campaign.scheduling.tasks import TOLD_PER_ROUND_MAX, UNCOUNTED_MAX
from saflite.contract import wire
from saflite.contract.bounds import TEXT_CHARS_MAX
from saflite.contract.work import HandedBack, MutateResult, MutateWork, Report, Stage


def flying(budget: int = 4) -> Driver:
    """Books with flights to be flown."""
    driver = new_books(budget)
    while not driver.books._core.tasks.waiting_count("fly"):
        for stage in ("mutate", "score"):
            driver.do(stage)
    return driver


def test_a_lease_handed_back_in_many_words_leaves_few() -> None:
    driver = flying()
    (lease,) = driver.ask("fly")
    words = HandedBack(message="\U0001f600" * TEXT_CHARS_MAX)
    report = Report(worker="a", lease_id=lease.lease_id, epoch=lease.epoch, result=words)
    assert driver.books.report(wire.decode(wire.encode(report), Report), driver.now).status == "accepted"
    batch = driver.books.drain()
    kept = [*batch.lines, *(repr(row).encode() for row in batch.rows)]
    assert 0 < sum(map(len, kept)) < 6_000
    assert all(len(task.message) < 1_000 for task in driver.books._core.tasks)


@pytest.mark.parametrize("stage", get_args(Stage))
def test_work_is_not_handed_back_without_end(stage: Stage) -> None:
    """All other work is done; what one stage is given it hands back."""
    driver, times = new_books(2), 0
    while not driver.books.ended:
        for lease in driver.ask(stage, "evil"):
            times += 1
            assert times < 40 * UNCOUNTED_MAX, "the campaign does not end"
            assert driver.report(lease, HandedBack(), "evil").status == "accepted"
        for other in get_args(Stage):
            if other != stage:
                driver.do(other, many=9)
        driver.now += 0.5
        driver.books.tick(driver.now)
    assert times > UNCOUNTED_MAX


def test_workers_that_stop_cost_no_attempt() -> None:
    driver = flying()
    for number in range(UNCOUNTED_MAX):
        (lease,) = driver.ask("fly", f"w{number}")
        driver.report(lease, HandedBack(message="SIGTERM"), f"w{number}")
    assert {task.losses for task in driver.books._core.tasks} == {0}
    driver.run()
    assert driver.books.status(driver.now).flights == 4


def test_a_mutator_is_not_told_without_end() -> None:
    driver, times = new_books(40), 0
    driver.run(until_flights=15)
    (lease,) = driver.wait_for("mutate", "evil", cursor=-1)
    assert isinstance(lease.work, MutateWork)
    round_ = lease.work.round
    while not driver.books.ended:
        times += 1
        assert times < 2 * (UNCOUNTED_MAX + TOLD_PER_ROUND_MAX * round_), "it is told for ever"
        task = next(task for task in driver.books._core.tasks if task.stage == "mutate")
        task.catching_up = True  # as where there is more to tell than goes into one message
        driver.report(lease, MutateResult(round=round_, test_cases=()), "evil")
        (lease,) = driver.ask("mutate", "evil", cursor=-1) or (lease,)
    assert times > UNCOUNTED_MAX
