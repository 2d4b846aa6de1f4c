"""One suite for every target found by its place that can fly on this machine."""

from __future__ import annotations

import pytest

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FLOWN_ENDINGS, trace_digest
from saflite.contract.signals import SIGNALS
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.simulator_worker.registry import load_target, target_names, why_missing


@pytest.fixture(params=target_names())
def name(request: pytest.FixtureRequest) -> str:
    reason = why_missing(load_target(request.param))
    if reason:
        pytest.skip(f"{request.param}: {reason}")
    return str(request.param)


def case(name: str, rng_seed: int = 1, *, kind: str = "LOITER") -> TestCase:
    scenario = Scenario(start=StartState(mode=kind, altitude_m=20.0), time_limit_s=3.0)
    return TestCase(target=Target(name=name), scenario=scenario, rng_seed=rng_seed)


def test_flies_and_writes_known_signals(name: str) -> None:
    record = load_target(name).fly(case(name), lambda: False)
    assert record.ending in FLOWN_ENDINGS
    assert record.trace is not None
    assert record.trace.samples > 10
    assert set(record.trace.signals) <= set(SIGNALS)
    assert {"x_m", "y_m", "altitude_m", "obstacle_distance_m", "mode", "armed"} <= set(record.trace.signals)
    assert len({len(data) for data in record.trace.signals.values()}) == 1


def test_flies_the_same_again(name: str) -> None:
    digests = set()
    for _ in range(2):
        trace = load_target(name).fly(case(name), lambda: False).trace
        assert trace is not None
        digests.add(trace_digest(trace))
    assert len(digests) == 1


def test_refuses_what_it_cannot_fly(name: str) -> None:
    wrong = Stimulus(at_s=1.0, kind="stick", name="RC99", values=(1500.0,))
    bad = TestCase(target=Target(name=name), scenario=case(name).scenario, stimuli=(wrong,))
    with pytest.raises(Refused):
        load_target(name).check(bad)
    with pytest.raises(Refused):
        load_target(name).check(case(name, kind="NO_SUCH_MODE"))


def test_stops_when_cancelled(name: str) -> None:
    with pytest.raises(Unavailable):
        load_target(name).fly(case(name), lambda: True)
