"""Healthy flights in which two failsafes are raised by one tick: each takes its mode, and a sample shows the last only.

Position, battery and fence are looked at in the same tick, ten times a second, so that this is no rare thing.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
import pytest
from stimuli import fault, mode, setting

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.oracle.judge import judge
from saflite.oracle.policy import policies_for

BEGINS_S, FLOWN_S, BRAKES = 5.0, 12.0, 4.0
SETTINGS = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 1.0, "BATT_LOW_VOLT": 10.5, "BATT_LOW_TIMER": 0.0}


class Cause(NamedTuple):
    """What raises a failsafe: the setting of its action, the codes tried, and the input."""

    action: str
    codes: tuple[float, ...]
    name: str
    value: float


CAUSES = {
    "failsafe_radio": Cause("FS_THR_ENABLE", (1.0, 3.0), "SIM_RC_FAIL", 1.0),
    "failsafe_gps": Cause("FS_EKF_ACTION", (1.0, 2.0), "SIM_GPS_DISABLE", 1.0),
    "failsafe_battery": Cause("BATT_FS_LOW_ACT", (1.0, 2.0), "SIM_BATT_VOLTAGE", 10.2),
    "failsafe_fence": Cause("FENCE_ACTION", (1.0, 2.0, BRAKES), "FENCE_ALT_MAX", 12.0),
}
PAIRS = list(combinations(CAUSES, 2))


class Flown(NamedTuple):
    """When each failsafe was raised first, and the rules that were broken."""

    raised_s: dict[str, float]
    broken: dict[str, str]


def flown(codes: dict[str, float], begins_s: dict[str, float], *before: Stimulus) -> Flown:
    """Fly in LOITER; bring about the failsafes named, each at its time, with the actions given."""
    stimuli = [*before]
    for name, at_s in begins_s.items():
        cause = CAUSES[name]
        word = fault if cause.name.startswith("SIM_") else setting
        stimuli.append(word(round(at_s, 6), cause.name, cause.value))
    scenario = Scenario(start=StartState(mode="LOITER", altitude_m=30.0), time_limit_s=FLOWN_S)
    case = TestCase(target=Target(parameters={**SETTINGS, **codes}), scenario=scenario, stimuli=tuple(stimuli))
    record = fly_once(case)
    assert record.trace is not None
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    told = judge(case, flight, record.trace, policies_for("reference")).verdicts
    raised = {name: int(np.argmax(record.trace.array(name) > 0)) * record.trace.step_s for name in begins_s}
    return Flown(raised, {one.policy: one.message for one in told if one.outcome == "violated"})


@cache
def takes_s(name: str) -> float:
    """Return how long after its cause a failsafe is raised."""
    return flown({}, {name: BEGINS_S}).raised_s[name] - BEGINS_S


@pytest.mark.parametrize("pair", PAIRS)
def test_no_rule_is_broken_by_two_failsafes_of_one_tick(pair: tuple[str, str]) -> None:
    begins_s = {name: BEGINS_S + 2.0 - takes_s(name) for name in pair}
    first, second = (CAUSES[name] for name in pair)
    for code, other in product(first.codes, second.codes):
        for before in ("LOITER", "BRAKE") if other == BRAKES else ("LOITER",):
            found = flown({first.action: code, second.action: other}, begins_s, mode(3.0, before))
            assert len(set(found.raised_s.values())) == 1, "they did not meet"
            assert not found.broken, (code, other, before)


@pytest.mark.parametrize("name", ["failsafe_radio", "failsafe_gps"])
def test_no_rule_is_broken_by_a_battery_that_gets_critical_in_the_tick_of_another_failsafe(name: str) -> None:
    at_s, cause = BEGINS_S + 2.0, CAUSES[name]
    low = fault(3.0, "SIM_BATT_VOLTAGE", 10.2)
    critical = fault(round(at_s - takes_s("failsafe_battery"), 6), "SIM_BATT_VOLTAGE", 9.5)
    levels = {"BATT_FS_LOW_ACT": 0.0, "BATT_CRT_VOLT": 10.0}
    for code, other in product(cause.codes, (1.0, 2.0)):
        codes = {**levels, cause.action: code, "BATT_FS_CRT_ACT": other}
        assert not flown(codes, {name: at_s - takes_s(name)}, low, critical).broken, (code, other)
