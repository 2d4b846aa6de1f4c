"""A peer with a key says valid messages late, twice, out of order, for another's lease, attempt or run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from typing import get_args

import msgspec
import numpy as np
import pytest
from books_drive import Driver, new_books

from saflite.contract import wire
from saflite.contract.blobs import BlobMissing
from saflite.contract.flight import Delivered
from saflite.contract.rng import derive
from saflite.contract.verdict import Transition
from saflite.contract.work import (
    FlyResult,
    FlyWork,
    HandedBack,
    Heartbeat,
    JudgeResult,
    JudgeWork,
    Lease,
    MutateResult,
    Report,
    Stage,
)
from saflite.flight.mission import builtin_mission

WORKERS = ("a", "b", "c")


def _rogue(report: Report, held: list[tuple[str, Lease]]) -> list[Report]:
    """Return what others may say of a result: under another name, of another attempt, of another run.

    Work that lapsed may have been lent to a worker anew: who holds that attempt, too, says nothing false.
    """
    true = {(worker, lease.lease_id, lease.epoch) for worker, lease in held}
    return [one for one in _untrue(report) if (one.worker, one.lease_id, one.epoch) not in true]


def _untrue(report: Report) -> Iterator[Report]:
    for worker in (*WORKERS, "stranger"):
        if worker != report.worker:
            yield msgspec.structs.replace(report, worker=worker)
    for epoch in {report.epoch + 1, max(report.epoch - 1, 0)}:
        yield msgspec.structs.replace(report, epoch=epoch)
    yield msgspec.structs.replace(report, lease_id="0" * 12 + report.lease_id[12:])


def _said(driver: Driver, report: Report) -> str:
    receipt = driver.books.report(wire.decode(wire.encode(report), Report), driver.now)
    driver.commit()
    return receipt.status


def _result_of(driver: Driver, lease: Lease, worker: str) -> Report:
    report = Report(worker=worker, lease_id=lease.lease_id, epoch=lease.epoch, result=HandedBack())
    with suppress(BlobMissing):  # so late that its trace is gone
        return msgspec.structs.replace(report, result=driver.service.do(lease.work))
    return report


def _one_step(driver: Driver, held: list[tuple[str, Lease]], rng: np.random.Generator, taken: list[Report]) -> None:
    stage: Stage = get_args(Stage)[rng.integers(len(get_args(Stage)))]
    worker = WORKERS[rng.integers(len(WORKERS))]
    held += [(worker, lease) for lease in driver.ask(stage, worker, int(rng.integers(1, 4)))]
    if held and rng.random() < 0.8:
        worker, lease = held.pop(int(rng.integers(len(held))))
        report = _result_of(driver, lease, worker)
        before = msgspec.structs.replace(report, result=HandedBack())
        assert not [one for one in _rogue(before, held) if _said(driver, one) == "accepted"], "before it was done"
        if _said(driver, report) == "accepted":
            taken.append(report)
        assert not [one for one in _rogue(report, held) if _said(driver, one) == "accepted"], "after it was done"
    for _, lease in held[-1:]:
        beat = Heartbeat(worker="stranger", stage=stage, leases=((lease.lease_id, lease.epoch),))
        assert driver.books.beat(beat, driver.now).refused
    if rng.random() < 0.05:
        driver.books.absent(worker, stage, driver.now)
        driver.commit()


@pytest.mark.parametrize("seed", range(4))
def test_only_who_holds_a_lease_is_believed_and_once(seed: int) -> None:
    driver, rng = new_books(6, shrink=bool(seed % 2), shrink_flights_max=5 * (seed % 2)), derive(seed, "rogue")
    held: list[tuple[str, Lease]] = []
    taken: list[Report] = []
    while not driver.books.ended:
        _one_step(driver, held, rng, taken)
        again = taken[int(rng.integers(len(taken)))] if taken else None
        assert again is None or isinstance(again.result, HandedBack) or _said(driver, again) != "accepted"
        driver.now += float(rng.choice([0.0, 0.1, 0.5, 30.0], p=[0.4, 0.3, 0.29, 0.01]))
        driver.books.tick(driver.now)
        driver.commit()
        assert driver.now < 1e5, "the campaign does not end"
    settled = Counter(report.lease_id for report in taken if not isinstance(report.result, HandedBack))
    assert set(settled.values()) == {1}, "counted twice"
    assert driver.books.status(driver.now).flights == 6


def test_a_mutator_plants_no_defect() -> None:
    """What flies is the campaign's to say: a find of a vehicle made worse would be one of another vehicle."""
    driver = new_books()
    (lease,) = driver.ask("mutate")
    honest = driver.service.do(lease.work)
    assert isinstance(honest, MutateResult)
    case = honest.test_cases[0]
    settings = {**case.target.settings, "defects": ["parachute-in-acro"]}
    worse = msgspec.structs.replace(case, target=msgspec.structs.replace(case.target, settings=settings))
    planted = msgspec.structs.replace(honest, test_cases=(worse, *honest.test_cases[1:]))
    receipt = driver.report(lease, planted)
    assert receipt.status == "refused"
    assert "settings" in receipt.message


@pytest.mark.parametrize("kept", ["x", "[]", '{"simulation": 3, "mission": 3}', '{"saflite": 1, "_items_extra": 1}'])
@pytest.mark.parametrize("part", ["source", "plan"])
def test_a_mutator_keeps_no_file_that_is_none(kept: str, part: str) -> None:
    """What is found is written as competition YAML and plans, which begin with what the test case kept of them."""
    driver = new_books()
    (lease,) = driver.ask("mutate")
    honest = driver.service.do(lease.work)
    assert isinstance(honest, MutateResult)
    case = honest.test_cases[0]
    if part == "source":
        odd = msgspec.structs.replace(case, source=kept)
    else:
        mission = msgspec.structs.replace(builtin_mission("mission1"), plan_extra=kept)
        odd = msgspec.structs.replace(case, scenario=msgspec.structs.replace(case.scenario, mission=mission))
    receipt = driver.report(lease, msgspec.structs.replace(honest, test_cases=(*honest.test_cases[1:], odd)))
    assert receipt.status == "refused"
    assert "can be written" in receipt.message


def test_a_mutator_may_propose_what_was_read_from_files() -> None:
    driver = new_books()
    (lease,) = driver.ask("mutate")
    honest = driver.service.do(lease.work)
    assert isinstance(honest, MutateResult)
    case = msgspec.structs.replace(honest.test_cases[0], source='{"robot":{"port":"ros"}}')
    scenario = msgspec.structs.replace(case.scenario, mission=builtin_mission("mission1"))
    read = msgspec.structs.replace(case, scenario=scenario)
    receipt = driver.report(lease, msgspec.structs.replace(honest, test_cases=(read, *honest.test_cases[1:])))
    assert receipt.status == "accepted", receipt.message


@pytest.mark.parametrize("stage", ["fly", "judge"])
@pytest.mark.parametrize(("beyond", "status"), [(-1, "accepted"), (0, "refused"), (2**50, "refused")])
def test_nobody_tells_of_stimuli_that_a_test_case_has_not(stage: Stage, beyond: int, status: str) -> None:
    """Whoever reads the run would look for it, and could tell nothing of the run: no report, and no export."""
    driver = new_books()
    (lease, *_) = driver.wait_for(stage, "a", -1)
    assert isinstance(lease.work, FlyWork | JudgeWork)
    place, result = len(lease.work.test_case.stimuli) + beyond, driver.service.do(lease.work)
    if isinstance(result, FlyResult):
        result = FlyResult(flight=msgspec.structs.replace(result.flight, delivered=(Delivered(index=place, at_s=1.0),)))
    elif isinstance(result, JudgeResult):
        step = Transition(before="GUIDED flying", after="LAND flying", stimulus=place)
        result = JudgeResult(judgement=msgspec.structs.replace(result.judgement, transitions=(step,)))
    assert driver.report(lease, result).status == status
