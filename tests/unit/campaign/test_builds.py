"""A re-flight repeats a flight only on the same build of its target."""

from __future__ import annotations

from typing import cast

import msgspec
import pytest
from books_drive import Driver, MemoryStore, doubles, new_books
from test_chance import Chancy

from saflite.campaign.storage.store import Store
from saflite.contract.blobs import Blobs
from saflite.contract.events import FaultSeen, Flown, ViolationFound
from saflite.contract.join import Join
from saflite.contract.topics import PROTOCOL
from saflite.contract.verdict import Violation
from saflite.contract.work import FlyResult, FlyWork, Heartbeat, Lease, Receipt, Result, TargetBuild, Work

ONE, OTHER = (TargetBuild("reference", "one"),), (TargetBuild("reference", "other"),)


class Builder(doubles.Service):
    """Flies on a build."""

    def __init__(self, build: str, blobs: Blobs) -> None:
        super().__init__(blobs)
        self.build = build

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if isinstance(result, FlyResult):
            return FlyResult(flight=msgspec.structs.replace(result.flight, build=self.build))
        return result


def facts(driver: Driver, kind: type) -> list[object]:
    driver.commit()
    assert isinstance(driver.store, MemoryStore)
    return [event.fact for event in driver.store.all_events if isinstance(event.fact, kind)]


def violations(driver: Driver) -> list[Violation]:
    return [fact.violation for fact in facts(driver, ViolationFound) if isinstance(fact, ViolationFound)]


def reflying(**search: object) -> tuple[Driver, Lease]:
    """Bring a campaign to its first re-flight, leased to `a`, which has the build; everything was flown on it."""
    driver = new_books(40, repeats="bitwise", confirm_flights=1, **search)
    driver.targets = {"a": ONE}
    assert driver.store is not None
    driver.service = Builder("one", driver.store.blobs)
    while True:
        for stage in ("mutate", "score", "judge"):
            driver.do(stage, many=9)
        driver.now += 20.0  # nobody else is on the way
        (lease,) = driver.ask("fly")
        assert isinstance(lease.work, FlyWork)
        if lease.work.purpose == "confirm" and not doubles.is_flaky(lease.lease_id.split("/")[1]):
            return driver, lease
        driver.report(lease, driver.service.do(lease.work))


def fly_on(driver: Driver, lease: Lease, build: str, worker: str = "a") -> Receipt:
    assert driver.store is not None
    result = Builder(build, driver.store.blobs).do(lease.work)
    return driver.report(lease, result, worker)


@pytest.mark.parametrize("build", ["other", ""])
def test_a_reflight_on_another_build_counts_for_nothing_and_is_flown_again(build: str) -> None:
    driver, lease = reflying()
    flights = driver.books.status(driver.now).flights
    receipt = fly_on(driver, lease, build)
    assert receipt.status == "refused"
    assert "build 'one'" in receipt.message
    assert driver.books.status(driver.now).flights == flights
    assert violations(driver) == []
    driver.now += 30.0  # nobody else who has the build was there for a while
    again = next(one for one in driver.ask("fly", leases_max=16) if one.lease_id == lease.lease_id)
    assert fly_on(driver, again, "one").status == "accepted"
    driver.do("judge", many=9)
    (found,) = violations(driver)
    assert (found.confirmation, found.reflown) == ("confirmed", 1)


def test_a_smallest_form_is_flown_on_no_build_where_nobody_tells_any() -> None:
    """Which of its flights is the first to show the violation moves on: a build named once would stay."""
    driver = new_books(3, repeats="statistically", shrink=True, record="none")
    assert driver.store is not None
    driver.service = Chancy(0.7, "ABC", driver.store.blobs)
    lease, worker = _smallest_form(driver)
    flown = driver.service.do(lease.work)
    assert isinstance(flown, FlyResult)
    odd = FlyResult(flight=msgspec.structs.replace(flown.flight, build="other"))
    assert driver.report(lease, odd, worker).status == "refused"


def _smallest_form(driver: Driver) -> tuple[Lease, str]:
    """Bring a campaign to the first flight of a smallest form; returns its lease, and whose it is."""
    while not driver.books.ended:
        for worker in ("a", "b"):
            for stage in ("mutate", "score", "judge"):
                driver.do(stage, worker, many=9)
            for lease in driver.ask("fly", worker):
                if isinstance(lease.work, FlyWork) and lease.work.purpose == "shrunk":
                    return lease, worker
                driver.report(lease, driver.service.do(lease.work), worker)
        driver.now += 0.5
        driver.books.tick(driver.now)
    raise AssertionError("no find was made small")


def test_work_on_a_build_is_given_only_to_workers_that_have_it() -> None:
    driver, lease = reflying()
    driver.books.absent("a", "fly", driver.now)
    driver.targets |= {"b": OTHER, "c": (*OTHER, *ONE)}
    assert lease.lease_id not in {one.lease_id for one in driver.ask("fly", "b", 16)}
    assert lease.lease_id in {one.lease_id for one in driver.ask("fly", "c", 16)}


def test_a_build_nobody_has_any_more_leaves_the_violation_unconfirmed_and_says_why() -> None:
    driver, lease = reflying()
    driver.books.absent("a", "fly", driver.now)
    driver.targets = {"b": OTHER}
    for _ in range(100):
        driver.ask("fly", "b", 0)
        driver.now += 1.0
        driver.books.tick(driver.now)
    (found,) = violations(driver)
    assert (found.test_case, found.confirmation, found.reflown) == (lease.lease_id.split("/")[1], "unconfirmed", 0)
    assert "no worker has build one of reference" in found.message


def test_a_worker_that_has_the_build_and_never_asks_for_work_does_not_count() -> None:
    driver, _ = reflying()
    driver.books.absent("a", "fly", driver.now)
    driver.targets = {"b": OTHER}
    assert not driver.books.join(Join(protocol=PROTOCOL, worker="z", stage="fly", targets=ONE), driver.now)
    for _ in range(100):
        driver.ask("fly", "b", 0)
        driver.books.beat(Heartbeat(worker="z", stage="fly"), driver.now)
        driver.now += 1.0
        driver.books.tick(driver.now)
    (found,) = violations(driver)
    assert (found.confirmation, found.reflown) == ("unconfirmed", 0)


def test_while_nobody_flies_at_all_a_reflight_waits() -> None:
    driver, _ = reflying()
    driver.books.absent("a", "fly", driver.now)
    for _ in range(200):
        driver.now += 1.0
        driver.books.tick(driver.now)
    assert violations(driver) == []


def test_workers_that_lie_about_their_build_cannot_keep_a_violation_open_for_ever() -> None:
    driver, lease = reflying()
    for _ in range(40):
        fly_on(driver, lease, "other")
        driver.now += 30.0
        waiting = [one for one in driver.ask("fly", leases_max=16) if one.lease_id == lease.lease_id]
        if not waiting:
            break
        (lease,) = waiting
    (found,) = violations(driver)
    assert (found.confirmation, found.reflown) == ("unconfirmed", 0)
    assert "expected a flight on build 'one'" in found.message


def test_a_test_case_that_names_a_build_is_flown_on_it_only() -> None:
    target = msgspec.structs.replace(doubles.TEMPLATE.target, build="one")
    template = msgspec.structs.replace(doubles.TEMPLATE, target=target)
    store = MemoryStore(doubles.campaign(6), template, doubles.TARGET)
    driver = Driver(store.rebuild(), cast(Store, store))
    driver.targets = {"b": OTHER, "a": ONE}
    driver.do("mutate")
    driver.do("score", many=9)
    assert driver.ask("fly", "b", 3) == ()
    (lease,) = driver.ask("fly", "a")
    assert fly_on(driver, lease, "other").status == "refused"
    for _ in range(100):
        driver.ask("fly", "b", 0)
        driver.now += 1.0
        driver.books.tick(driver.now)
    told = [fact.message for fact in facts(driver, FaultSeen) if isinstance(fact, FaultSeen)]
    assert sum("first flights wait: no worker has build one" in message for message in told) == 1
    assert driver.store is not None
    driver.service = Builder("one", driver.store.blobs)
    driver.run(("a",))
    assert driver.books.status(driver.now).flights == 6
    assert {fact.build for fact in facts(driver, Flown) if isinstance(fact, Flown)} == {"one"}


def test_flights_that_are_made_smaller_stay_on_the_build() -> None:
    driver, _ = reflying(shrink=True, shrink_flights_max=10)
    for _ in range(12):
        for stage in ("mutate", "score", "judge", "record"):
            driver.do(stage, many=9)
        for lease in driver.ask("fly", leases_max=9):
            assert isinstance(lease.work, FlyWork)
            if lease.work.purpose in ("shrink", "shrunk"):
                assert fly_on(driver, lease, "other").status == "refused"
                return
            driver.report(lease, driver.service.do(lease.work))
        driver.now += 11.0
        driver.books.tick(driver.now)
    pytest.fail("nothing was made smaller")


def different(repeats: str) -> Driver:
    """A campaign some of whose flights, flown over again on the same build, are other flights."""
    driver = new_books(60, repeats=repeats)  # type: ignore[arg-type]
    driver.run()
    return driver


def test_a_flight_flown_over_again_that_is_no_repeat_is_a_fault_of_a_target_that_says_it_repeats() -> None:
    driver = different("bitwise")
    status = driver.books.status(driver.now)
    told = [fact for fact in facts(driver, FaultSeen) if isinstance(fact, FaultSeen)]
    told = [fact for fact in told if "says that it repeats bit by bit" in fact.message]
    assert len(told) == status.unequal > 0
    assert all(doubles.is_untrue(fact.where.split("/")[1]) and "/check/" in fact.where for fact in told)
    assert 10 <= status.checked <= 30, "about three of ten are asked for"
    assert status.flights == 60, "they count against no budget"


def test_it_is_no_fault_of_a_target_that_knows_chance() -> None:
    driver = different("statistically")
    assert facts(driver, FaultSeen) == []
    assert driver.books.status(driver.now).checked == driver.books.status(driver.now).unequal == 0


def test_a_campaign_may_go_without_checks_and_the_first_flight_always_is_one_where_there_are_any() -> None:
    for share, checked in ((0.0, 0), (1e-9, 1)):
        driver = new_books(20, check_share=share)
        driver.run()
        found = [fact.violation for fact in facts(driver, ViolationFound) if isinstance(fact, ViolationFound)]
        confirmed = {one.test_case for one in found if one.confirmation == "confirmed"}
        total = driver.books.status(driver.now).checked
        assert len(confirmed) > 1
        assert total in ((1, 2) if checked else (0,)), "the first confirmed find of the policy is one, too"
