"""Blobs that are missing or damaged: what cannot be judged is flown again, what cannot be recorded is given up."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import msgspec
import pytest
from books_drive import Driver, MemoryStore, doubles, new_books

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.console.run_data.run_folder import open_run
from saflite.contract.blobs import BlobRef
from saflite.contract.events import FaultSeen, Quarantined
from saflite.contract.flight import Purpose
from saflite.contract.work import (
    Failure,
    FlyResult,
    FlyWork,
    JudgeWork,
    Lease,
    Receipt,
    RecordWork,
    Report,
    Result,
    Stage,
    Work,
)
from saflite.runtime.evidence import look


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


@pytest.mark.parametrize("stage", ["judge", "record"])
@pytest.mark.parametrize("said", ["what never was", "what never was beside it", "that of another size"])
def test_what_a_peer_says_of_other_blobs_takes_no_flight_or_recording(stage: Stage, said: str, tmp_path: Path) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(12), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    lease = lent(driver, stage)
    trace, nothing = trace_of(lease), BlobRef(digest="0" * 64, size_bytes=1)
    larger = BlobRef(digest=trace.digest, size_bytes=trace.size_bytes + 1)
    unread = {"what never was": (nothing,), "what never was beside it": (trace, nothing)}.get(said, (larger,))
    told = Report(worker="a", lease_id=lease.lease_id, epoch=lease.epoch, result=Failure(message="no", unread=unread))
    before = driver.books.status(driver.now)
    assert not driver.books.awaits(told), "blobs of others are read for it"
    assert driver.books.report(told, driver.now, look(store.blobs, told) or "").status == "accepted"
    driver.commit()
    after = driver.books.status(driver.now)
    assert (after.flights, after.queues) == (before.flights, before.queues)
    (task,) = [one for one in driver.books._core.tasks if str(one.key) == lease.lease_id.partition(":")[2]]
    assert task.failures == 1, "it has failed, and is leased again"
    store.close()


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


def sized_wrong(result: Result) -> FlyResult:
    """Name the trace of a flight as larger than it is."""
    assert isinstance(result, FlyResult)
    flight = result.flight
    assert flight.trace is not None
    trace = BlobRef(digest=flight.trace.digest, size_bytes=flight.trace.size_bytes + 1)
    return FlyResult(flight=msgspec.structs.replace(flight, trace=trace))


@pytest.mark.parametrize("lease_id", ["of this run", "of another run", "no lease"])
def test_a_refused_result_cannot_drop_what_others_left_by_naming_its_digest(lease_id: str) -> None:
    """The books find what they hold by the digest: a wrong size beside it must not make it a blob nobody needs."""
    driver = new_books(10)
    store = cast(object, driver.store)
    assert isinstance(store, MemoryStore)
    lease = lent(driver, "fly")
    result = driver.service.do(lease.work)
    driver.report(lease, result)
    before = set(store.blobs.kept)
    assert before == {blob.digest for blob in driver.books.wanted_blobs}
    names = {"of this run": lease.lease_id, "of another run": "other:fly:x:search:0", "no lease": "x"}
    forged = Report(worker="rogue", lease_id=names[lease_id], epoch=lease.epoch, result=sized_wrong(result))
    assert driver.books.report(forged, driver.now, "blob 0123 is damaged").status != "accepted"
    driver.commit()
    assert set(store.blobs.kept) == before, "a stranger had a blob dropped that waits to be judged"
    driver.run()
    assert not any("is missing" in message for message in faults(driver)), "a flight was flown again"
    assert driver.books.status(driver.now).flights == 10


class Losing(doubles.Service):
    """Loses what a flight of `unlucky` left, every time; `unlucky` begins as the first test case of a purpose."""

    def __init__(self, store: Store, purpose: Purpose) -> None:
        super().__init__(store.blobs)
        self._store, self._purpose, self.unlucky = store, purpose, ""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if isinstance(work, FlyWork) and isinstance(result, FlyResult) and work.purpose == self._purpose:
            self.unlucky = self.unlucky or result.flight.test_case
            if result.flight.test_case == self.unlucky:
                for blob in result.flight.blobs:
                    self._store.blobs.path(blob.digest).unlink(missing_ok=True)
        return result


@pytest.mark.parametrize("purpose", ["search", "shrink"])
def test_a_flight_that_loses_its_trace_again_and_again_is_given_up(tmp_path: Path, purpose: Purpose) -> None:
    campaign = doubles.campaign(30, record="none", shrink=purpose == "shrink", check_share=0.0)
    store = Store.create(tmp_path / "run", campaign, doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.service = losing = Losing(store, purpose)
    driver.run()
    assert driver.books.status(driver.now).flights == 30
    store.close()
    assert losing.unlucky
    with open_run(tmp_path / "run") as run:
        told = [event.fact for event in run.events() if isinstance(event.fact, FaultSeen)]
        given_up = [event.fact for event in run.events() if isinstance(event.fact, Quarantined)]
    lost = [fact for fact in told if "is missing" in fact.message]
    assert len(lost) == (campaign.lease.attempts_max if purpose == "search" else 1)  # tries to shrink tell of the end
    assert [one.test_case for one in given_up] == ([losing.unlucky] if purpose == "search" else [])
    if purpose == "search":
        assert (given_up[0].attempts, given_up[0].last) == (3, "infra")
        assert "its trace was lost 3 times" in given_up[0].message
    figures = audit(tmp_path / "run")
    assert (figures["problems"], figures["flights"]) == ([], 30)
