"""Healthy flights with every action a failsafe may be set to: what the vehicle documents, its rules have to know.

A code that the vehicle takes in one way and a rule reads in another is an alarm in every search that draws it.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from stimuli import fault, mode, setting
from thinned import thinned

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.flight.autopilots.reference.describe import describe
from saflite.oracle.judge import judge
from saflite.oracle.policy import policies_for

BEGINS_S, FLOWN_S = 5.0, 12.0
MODES = ("LOITER", "ALT_HOLD", "STABILIZE", "GUIDED", "CIRCLE")
RAISED = {
    "FS_THR_ENABLE": (fault(BEGINS_S, "SIM_RC_FAIL", 1.0),),
    "FS_EKF_ACTION": (fault(BEGINS_S, "SIM_GPS_DISABLE", 1.0),),
    "BATT_FS_LOW_ACT": (setting(BEGINS_S, "BATT_LOW_TIMER", 0.0), fault(BEGINS_S, "SIM_BATT_VOLTAGE", 10.2)),
    "BATT_FS_CRT_ACT": (setting(BEGINS_S, "BATT_LOW_TIMER", 0.0), fault(BEGINS_S, "SIM_BATT_VOLTAGE", 9.5)),
    "FENCE_ACTION": (setting(BEGINS_S, "FENCE_ALT_MAX", 12.0),),
}
SETTINGS = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 3.0, "BATT_LOW_VOLT": 10.5, "BATT_CRT_VOLT": 10.0}
SPEAKS = {
    "FS_THR_ENABLE": "radio-failsafe-action",
    "FS_EKF_ACTION": "gps-failsafe-action",
    "BATT_FS_LOW_ACT": "battery-failsafe-action",
    "FENCE_ACTION": "fence-action",
}


def codes() -> Iterator[tuple[str, float]]:
    """Return each action of each failsafe, over the range that the vehicle documents."""
    for entry in describe().inputs:
        if entry.name in RAISED:
            assert entry.low is not None
            assert entry.high is not None
            yield from ((entry.name, float(code)) for code in range(int(entry.low), int(entry.high) + 1))


def verdicts(name: str, code: float, before: str, raised: tuple[Stimulus, ...]) -> dict[str, tuple[str, str]]:
    parameters = {**SETTINGS, name: code}
    if name == "BATT_FS_LOW_ACT":
        parameters["BATT_CRT_VOLT"] = 0.0  # its rule asks nothing where another level has an action of its own
    scenario = Scenario(start=StartState(mode="LOITER", altitude_m=30.0), time_limit_s=FLOWN_S)
    stimuli = (mode(3.0, before), *raised)
    case = TestCase(target=Target(parameters=parameters), scenario=scenario, stimuli=stimuli)
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    found = judge(case, flight, record.trace, policies_for("reference")).verdicts
    return {one.policy: (one.outcome, one.message) for one in found}


def test_every_failsafe_has_its_codes_here() -> None:
    assert {name for name, _ in codes()} == set(RAISED)


@pytest.mark.parametrize(("name", "code"), thinned(list(codes()), each=2))
def test_no_rule_is_broken_by_an_action_that_is_documented(name: str, code: float) -> None:
    broken: dict[str, str] = {}
    spoke = False
    for before in MODES:
        told = verdicts(name, code, before, RAISED[name])
        broken |= {f"{rule} from {before}": why for rule, (how, why) in told.items() if how == "violated"}
        spoke |= name in SPEAKS and told[SPEAKS[name]][0] == "held"
    assert not broken
    assert spoke or name not in SPEAKS or code == 0.0, "its rule said nothing of any of these flights"


@pytest.mark.parametrize("name", list(RAISED))
def test_of_a_number_between_two_codes_the_fraction_is_lost(name: str) -> None:
    for code in [code for known, code in codes() if known == name][:-1]:
        told = verdicts(name, code + 0.3, "LOITER", RAISED[name])
        assert not {rule: why for rule, (how, why) in told.items() if how == "violated"}
