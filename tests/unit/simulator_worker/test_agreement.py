"""A target that does not do what it says of itself is refused at the worker's first flight, saying which."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import contrary
import msgspec
import pytest
from contrary import BUILD

from saflite.conformance.kit import findings
from saflite.conformance.targets import check_repeatable_target, checks_of
from saflite.contract.errors import Refused
from saflite.contract.flight import SAMPLES_MAX, FlightRecord, Trace
from saflite.contract.ids import digest
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.work import FlyResult, FlyWork
from saflite.evidence.memory import MemoryBlobs
from saflite.runtime.clock import WallClock
from saflite.simulator_worker import agreement
from saflite.simulator_worker.work import Flyer, open_service

TARGET = Path(contrary.__file__)
WRONG = {
    contrary.SIGNAL: "lacks x_m",
    contrary.SAMPLES: "not of",
    contrary.ENDING: "ending 'exploded'",
    contrary.INDEX: "delivered stimulus 1",
    contrary.REPEAT: "altitude_m, x_m not equal bit by bit",
    contrary.EARLY: "before it was due",
    contrary.NO_TRACE: "without a trace",
    contrary.NEW_SIGNAL: "holds y_m",
    contrary.FILE_NAME: "artefacts called '../console.txt'",
    contrary.MESSAGE: "message: expected a text, got NoneType",
    contrary.LIMIT: "with 0.54 s instead of 1 s: altitude_m, x_m not equal bit by bit",
    contrary.ENDLESS: "lasted 0.9 s, expected 0.54",
}
CHECKS = {
    contrary.REPEAT: "repeats_bit_by_bit",
    contrary.LIMIT: "begins_alike_whatever_its_time_limit",
    contrary.ENDLESS: "begins_alike_whatever_its_time_limit",
}


def case(wrong: int, build: str = "") -> TestCase:
    stimulus = Stimulus(at_s=0.5, kind="parameter", name="WRONG", values=(0.0,))
    scenario = Scenario(start=StartState(), time_limit_s=1.0)
    target = Target(name="contrary", parameters={"WRONG": wrong}, build=build)
    return TestCase(target=target, scenario=scenario, stimuli=(stimulus,))


def fly(flyer: Flyer, test_case: TestCase) -> FlyResult:
    result = flyer.do(FlyWork(test_case=test_case, flight_index=0, purpose="search", wall_limit_s=20.0), lambda: False)
    assert isinstance(result, FlyResult)
    return result


@pytest.fixture
def flyer() -> Iterator[Flyer]:
    flyer = open_service("fly-1", WallClock(), MemoryBlobs(), [TARGET], verify=True)
    yield flyer
    flyer.close()


def test_a_flight_that_agrees_comes_back_with_build_deliveries_and_artefacts(flyer: Flyer) -> None:
    result = fly(flyer, case(contrary.RIGHT))
    assert result.flight.build == BUILD
    assert result.flight.delivered is not None
    assert [(one.index, one.at_s) for one in result.flight.delivered] == [(0, 0.5)]
    (artefact,) = result.flight.artefacts
    assert artefact.name == "console.txt"
    assert fly(flyer, case(contrary.RIGHT, BUILD)).flight.ending == "completed"
    with pytest.raises(Refused, match=f"build of target contrary: expected {'c' * 64}, got {BUILD}"):
        fly(flyer, case(contrary.RIGHT, "c" * 64))


@pytest.mark.parametrize("wrong", [contrary.SIGNAL, contrary.REPEAT])
def test_the_first_flight_that_contradicts_is_refused_and_all_after_it(flyer: Flyer, wrong: int) -> None:
    for number in (wrong, contrary.RIGHT):
        with pytest.raises(Refused, match=f"target contrary: expected flights that agree.*{WRONG[wrong]}"):
            fly(flyer, case(number))


@pytest.mark.parametrize("wrong", WRONG)
def test_the_suite_finds_it(wrong: int) -> None:
    wanted = CHECKS.get(wrong, "flies_as_it_describes")
    checks = [check for check in checks_of(contrary, [case(wrong)]) if check.name == wanted]
    assert any(WRONG[wrong] in finding.text for finding in findings(checks))
    assert findings([check for check in checks_of(contrary, [case(contrary.RIGHT)]) if check.name == wanted]) == []


def test_the_suite_says_what_a_target_takes_that_it_does_not_have() -> None:
    found = findings(check_repeatable_target(contrary, [case(contrary.RIGHT)]))
    assert "check() takes a stick it does not have" in [finding.text for finding in found]


def test_a_trace_of_more_samples_than_are_judged_is_told() -> None:
    many = bytes(4 * (SAMPLES_MAX + 1))
    record = FlightRecord("completed", Trace(step_s=0.001, signals={"altitude_m": many, "x_m": many}))
    told = [*agreement.contradictions(contrary.describe(), case(contrary.RIGHT), record)]
    assert told == [f"the trace holds {SAMPLES_MAX + 1} samples, {SAMPLES_MAX} at most are judged"]


def test_a_description_that_contradicts_itself_is_told() -> None:
    info = contrary.describe()
    changed = msgspec.structs.replace(info, signals=("altitude_m", "warp_factor"), build="", start_states=())
    told = " ".join(agreement.own_contradictions(changed))
    assert "warp_factor" in told
    assert "no build" in told
    assert "start state" in told
    assert list(agreement.own_contradictions(info)) == []
    assert len(digest(b"")) == len(BUILD)
