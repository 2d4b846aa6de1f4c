"""Blobs that are missing or damaged: what cannot be judged is flown again, what cannot be recorded is given up."""

from __future__ import annotations

from typing import cast

from books_drive import Driver, MemoryStore, doubles, new_books

from saflite.contract.blobs import BlobRef
from saflite.contract.events import FaultSeen
from saflite.contract.work import (
    Failure,
    FlyResult,
    JudgeWork,
    Lease,
    Receipt,
    RecordWork,
    Report,
    Stage,
)


def lent(driver: Driver, stage: Stage) -> Lease:
    """Bring a campaign to the first piece of work of a stage, lent out."""
    while not (leases := driver.ask(stage)):
        others: list[Stage] = [other for other in ("mutate", "score", "fly", "judge") if other != stage]
        assert any(driver.do(other, worker, 9) for other in others for worker in ("a", "b"))
    return leases[0]


def report(driver: Driver, lease: Lease, result: object, damage: str) -> Receipt:
    told = Report(worker="a", lease_id=lease.lease_id, epoch=lease.epoch, result=result)  # type: ignore[arg-type]
    receipt = driver.books.report(told, driver.now, damage)
    driver.commit()
    return receipt


def trace_of(lease: Lease) -> BlobRef:
    assert isinstance(lease.work, JudgeWork | RecordWork)
    assert lease.work.flight.trace is not None
    return lease.work.flight.trace


def faults(driver: Driver) -> list[str]:
    store = cast(object, driver.store)
    assert isinstance(store, MemoryStore)
    return [event.fact.message for event in store.all_events if isinstance(event.fact, FaultSeen)]


def test_a_trace_the_judge_cannot_read_is_flown_again() -> None:
    driver = new_books(10)
    lease = lent(driver, "judge")
    before = driver.books.status(driver.now)
    unread = Failure(message="cannot be read", unread=(trace_of(lease),))
    assert report(driver, lease, unread, "blob 0123 is damaged").status == "accepted"
    after = driver.books.status(driver.now)
    assert (after.flights, after.queues["fly"]) == (before.flights - 1, before.queues["fly"] + 1)
    assert any("blob 0123 is damaged" in message for message in faults(driver))
    driver.run()
    assert driver.books.status(driver.now).flights == 10


def test_a_judge_that_cannot_read_what_is_there_has_failed() -> None:
    driver = new_books(10)
    lease = lent(driver, "judge")
    before = driver.books.status(driver.now)
    report(driver, lease, Failure(message="my disk", unread=(trace_of(lease),)), "")
    after = driver.books.status(driver.now)
    assert (after.flights, after.queues["judge"]) == (before.flights, before.queues["judge"])


def test_a_flight_whose_blobs_are_not_there_is_refused_and_flown_again() -> None:
    driver = new_books(10)
    lease = lent(driver, "fly")
    result = driver.service.do(lease.work)
    receipt = report(driver, lease, result, "blob 0123 is missing")
    assert (receipt.status, "blob 0123 is missing" in receipt.message) == ("refused", True)
    assert driver.books.status(driver.now).flights == 0
    driver.run()
    assert driver.books.status(driver.now).flights == 10


def test_a_trace_gone_when_it_is_to_be_judged_is_flown_again() -> None:
    driver = new_books(10)
    driver.do("mutate")
    driver.do("score", many=9)
    assert driver.do("fly") == 1
    store = cast(object, driver.store)
    assert isinstance(store, MemoryStore)
    store.blobs.kept.clear()
    assert driver.ask("judge") == ()
    assert any("is missing" in message for message in faults(driver))
    driver.run()
    assert driver.books.status(driver.now).flights == 10


def test_a_recording_whose_trace_is_gone_is_given_up() -> None:
    driver = new_books(20)
    lease = lent(driver, "record")
    driver.do("record", "b", 9)
    unread = Failure(message="cannot be read", unread=(trace_of(lease),))
    assert report(driver, lease, unread, "blob 0123 is missing").status == "accepted"
    assert any("no recording was written" in message for message in faults(driver))
    driver.run()
    assert driver.books.ended


def test_blobs_of_a_result_that_comes_too_late_are_dropped_unless_held() -> None:
    driver = new_books(10)
    store = cast(object, driver.store)
    assert isinstance(store, MemoryStore)
    lease = lent(driver, "fly")
    result = doubles.Service(store.blobs).do(lease.work)
    assert isinstance(result, FlyResult)
    driver.report(lease, result)
    assert driver.report(lease, result).status == "duplicate"
    assert {blob.digest for blob in result.flight.blobs} <= set(store.blobs.kept), "held until it is judged"
    driver.run()
    assert set(store.blobs.kept) == {blob.digest for blob in driver.books.wanted_blobs}
    driver.service.do(lease.work)
    assert driver.report(lease, result).status == "duplicate"
    assert set(store.blobs.kept) == {blob.digest for blob in driver.books.wanted_blobs}
