"""The list of workers stays short, however many lives a key has its workers lead."""

from __future__ import annotations

import pytest

from saflite.campaign.engine import worker_registry
from saflite.campaign.engine.worker_registry import WorkerRegistry
from saflite.contract.join import Join
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Heartbeat

LIVES = 50


def test_lives_without_end_leave_a_bounded_list_and_an_exact_sum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those gone stayed for minutes, all looked through at each that went; what they had spent stayed for good."""
    monkeypatch.setattr(worker_registry, "LIVES_MAX", 10)
    workers = WorkerRegistry()
    workers.join(_card("honest"), 0.0)
    for number in range(1, LIVES + 1):
        name, now_s = f"eve-{number}", 0.01 * number
        workers.join(_card(name), now_s, owner="eve")
        workers.beat(_beat(name, 1.0), now_s)
        workers.beat(_beat("honest", float(number)), now_s)  # of this life in all
        workers.leave("fly", name)
    assert workers.processor_s == LIVES + LIVES
    assert {one.worker for one in workers.others("fly", "", None, 0.0)} == {
        "honest",
        *(f"eve-{number}" for number in range(LIVES - 9, LIVES + 1)),
    }
    assert len(workers._spent_s) == 10


def _card(worker: str) -> Join:
    return Join(protocol=PROTOCOL, worker=worker, stage="fly", session="life")


def _beat(worker: str, processor_s: float) -> Heartbeat:
    return Heartbeat(worker=worker, stage="fly", session="life", processor_s=processor_s)
