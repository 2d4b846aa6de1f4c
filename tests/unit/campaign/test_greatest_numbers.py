"""Workers that tell the greatest numbers a message may hold: what the books make of them, every reader can read."""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from books_drive import Driver, doubles
from msgspec import inspect

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.console.run_data.run_folder import RunFolder
from saflite.console.view.report.data import read
from saflite.console.view.report.page import render
from saflite.contract import wire
from saflite.contract.bounds import COUNT_MAX
from saflite.contract.control import Answer, Control
from saflite.contract.events import Event
from saflite.contract.work import FlyResult, Heartbeat, JudgeResult, Orders, Result, ScoreResult, Stage

MEANT = ("round", "index", "flight_index", "value", "robustness", "nearness", "size_bytes")
"""Numbers that have to fit what was asked for, or each other."""


def _greatest(value: Any, info: inspect.Type) -> Any:
    """Return a value in which every number is as great as its type lets it be."""
    match info:
        case inspect.StructType():
            fields = {
                field.name: _greatest(getattr(value, field.name), field.type)
                for field in info.fields
                if field.name not in MEANT
            }
            return msgspec.structs.replace(value, **fields)
        case inspect.UnionType():
            fitting = [one for one in info.types if getattr(one, "cls", None) is type(value)]
            return _greatest(value, fitting[0]) if fitting else value
        case inspect.VarTupleType():
            return tuple(_greatest(one, info.item_type) for one in value)
        case inspect.TupleType():
            return tuple(_greatest(one, kind) for one, kind in zip(value, info.item_types, strict=True))
        case inspect.DictType():
            return {key: _greatest(one, info.value_type) for key, one in value.items()}
        case inspect.FloatType() | inspect.IntType() if info.le is not None:
            return type(value)(info.le)
    return value


def _told(result: Result) -> Result:
    """Return the result of a service with the greatest numbers; test cases stay as the search made them."""
    if isinstance(result, ScoreResult):
        faults = {f"fault {number}": 0 for number in range(1_000)}
        usage = {label: msgspec.structs.replace(one, faults=faults) for label, one in result.usage.items()}
        result = msgspec.structs.replace(result, usage=usage)
    if isinstance(result, FlyResult | JudgeResult | ScoreResult):
        greatest: Result = _greatest(result, inspect.type_info(type(result)))
        return greatest
    return result


def _work(driver: Driver, stage: Stage, worker: str) -> None:
    for lease in driver.ask(stage, worker, 2):
        beat = _greatest(Heartbeat(worker=worker, stage=stage), inspect.type_info(Heartbeat))
        wire.decode(wire.encode(driver.books.beat(beat, driver.now)), Orders)
        receipt = driver.report(lease, _told(driver.service.do(lease.work)), worker)
        assert receipt.status == "accepted", receipt.message[:500]


@pytest.mark.parametrize("record", ["violations", "all"])
def test_whatever_is_made_of_the_greatest_numbers_can_be_read(record: str, tmp_path: Path) -> None:
    campaign = doubles.campaign(12, record=record, candidates_per_round=16, flights_per_round=6)
    store = Store.create(tmp_path / "run", campaign, doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    while not driver.books.ended:
        for stage in get_args(Stage):
            for worker in ("a", "b"):
                _work(driver, stage, worker)
        for verb in ("status", "events"):
            answer = driver.books.control(Control(verb=verb, number=1), driver.now)
            for fact in wire.decode(wire.encode(answer), Answer).events:
                wire.decode(fact, Event)
        driver.now += 0.5
        driver.books.tick(driver.now)
        driver.commit()
    again = store.rebuild()
    again.begin(0.0, 1.7e9)
    again.validate()
    store.close()
    assert audit(tmp_path / "run")["clean"]
    with RunFolder(tmp_path / "run") as run:
        assert all(one.faults > COUNT_MAX and one.tokens_in > COUNT_MAX for one in run.usage())
        assert "What scoring took" in render(read(run), "run")
