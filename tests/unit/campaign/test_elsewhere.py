"""Work is kept for another worker only where another comes to take it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from books_drive import Driver, MemoryStore, doubles, new_books

from saflite.contract.events import ViolationFound
from saflite.contract.join import Join
from saflite.contract.topics import PROTOCOL
from saflite.contract.verdict import Violation
from saflite.contract.work import Ask, Failure, HandedBack, Heartbeat, Lease, Stage, TargetBuild

STAGES: tuple[Stage, ...] = ("mutate", "score", "fly", "judge", "record")
OURS, OTHER = (TargetBuild(doubles.TARGET.name, "x"),), (TargetBuild("another", "y"),)


class Beside:
    """A worker `z` beside the one that does the work: it has joined, and sends heartbeats."""

    def __init__(self, driver: Driver, stage: Stage = "fly", targets: tuple[TargetBuild, ...] = ()) -> None:
        self.driver, self.stage, self.targets = driver, stage, targets
        self.leases: tuple[Lease, ...] = ()
        card = Join(protocol=PROTOCOL, worker="z", stage=stage, targets=targets)
        assert not driver.books.join(card, driver.now)

    def beat(self) -> None:
        """Say that it lives and works."""
        held = tuple((lease.lease_id, lease.epoch) for lease in self.leases)
        self.driver.books.beat(Heartbeat(worker="z", stage=self.stage, leases=held), self.driver.now)

    def ask(self, targets: tuple[TargetBuild, ...] = ()) -> tuple[Lease, ...]:
        """Ask for one piece of work."""
        leases = self.driver.books.ask(Ask(worker="z", stage=self.stage, targets=targets), self.driver.now).leases
        self.driver.commit()
        return leases


def idles(_: Beside) -> None:
    """Never ask for work."""


def hangs(one: Beside) -> None:
    """Take one flight and never come to its end."""
    one.leases = one.leases or one.ask()


def asks_for_something_else(one: Beside) -> None:
    """Ask for flights on another target than that it has joined with."""
    assert not one.ask(OTHER)


def hands_back(one: Beside) -> None:
    """Take work and hand it back untouched."""
    for lease in one.ask(one.targets):
        one.driver.report(lease, HandedBack(), "z")


def flies(one: Beside) -> None:
    """Do the work."""
    for lease in one.ask(one.targets):
        one.driver.report(lease, one.driver.service.do(lease.work), "z")


def run_beside(
    driver: Driver, one: Beside, behave: Callable[[Beside], None], stages: tuple[Stage, ...] = STAGES
) -> None:
    """Run a campaign with one worker of each of the stages and another beside them."""
    while not driver.books.ended:
        one.beat()
        behave(one)
        for stage in stages:
            driver.do(stage, many=2)
        driver.now += 0.5
        driver.books.tick(driver.now)
        driver.commit()
        assert driver.now < 3_000.0, "what it never comes for is kept for it"


def violations(driver: Driver) -> list[Violation]:
    """Return what was decided upon, confirmed ones."""
    assert isinstance(driver.store, MemoryStore)
    found = [event.fact.violation for event in driver.store.all_events if isinstance(event.fact, ViolationFound)]
    return [one for one in found if one.confirmation == "confirmed"]


def finds(driver: Driver) -> list[tuple[str, str, int]]:
    """Return what is found whoever flew it."""
    return sorted((one.fingerprint, one.test_case, one.failed_again) for one in violations(driver))


@pytest.mark.parametrize("behave", [idles, hangs, asks_for_something_else, hands_back])
def test_who_never_flies_keeps_no_reflight_from_those_that_do(behave: Callable[[Beside], None]) -> None:
    driver = new_books(20)
    run_beside(driver, Beside(driver, targets=OURS if behave is asks_for_something_else else ()), behave)
    assert driver.books.status(driver.now).reflown
    assert {worker for one in violations(driver) for worker in one.workers} == {"a"}


def test_a_reflight_is_kept_for_another_that_asks_and_the_same_is_found() -> None:
    alone, both = new_books(20), new_books(20)
    alone.run(("a",))
    run_beside(both, Beside(both), flies)
    assert finds(both) == finds(alone) != []
    for one in violations(both):
        first, *again = one.workers
        assert first not in again[:1], "it was flown again where it was flown"


def test_what_one_could_not_judge_is_not_kept_for_another_that_never_asks() -> None:
    driver = new_books(6)
    Beside(driver, "judge")
    (lease,) = driver.wait_for("judge", "a", -1)
    driver.report(lease, Failure(message="not now"))
    driver.now += 60.0
    driver.books.beat(Heartbeat(worker="z", stage="judge"), driver.now)
    assert lease.lease_id in {one.lease_id for one in driver.ask("judge", "a", 9)}


def test_recordings_do_not_wait_for_a_recorder_that_never_asks() -> None:
    driver = new_books(20)
    run_beside(driver, Beside(driver, "record"), idles, ("mutate", "score", "fly", "judge"))
    assert driver.books.status(driver.now).violations_confirmed
