"""Flights without any defect that rules once took for violations."""

from __future__ import annotations

import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.oracle.judge import judge

HEIGHT_RULES = ("a-alt-hold2", "px-altitude1")


def flip(at_s: float) -> Stimulus:
    return Stimulus(at_s=at_s, kind="mode", name="FLIP")


Case = tuple[float, dict[str, float], tuple[Stimulus, ...]]
FLIP_UPON_FLIP: Case = (50.0, {}, (flip(1.0), flip(2.02)))
ABOVE_THE_CEILING: Case = (120.0, {"FENCE_ENABLE": 1.0}, ())


@pytest.mark.parametrize(("altitude_m", "parameters", "stimuli"), [FLIP_UPON_FLIP, ABOVE_THE_CEILING])
def test_nothing_is_broken_where_the_manual_allows_it(
    altitude_m: float, parameters: dict[str, float], stimuli: tuple[Stimulus, ...]
) -> None:
    scenario = Scenario(start=StartState(mode="ALT_HOLD", altitude_m=altitude_m), time_limit_s=20.0)
    case = TestCase(target=Target(parameters=parameters), scenario=scenario, stimuli=stimuli)
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    verdicts = judge(case, flight, record.trace, HEIGHT_RULES).verdicts
    assert {verdict.outcome for verdict in verdicts} <= {"held", "vacuous"}
