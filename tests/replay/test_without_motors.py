"""Healthy vehicles that come down without motors, as they were told: no rule may ask for more than gravity gives."""

from __future__ import annotations

import pytest
from stimuli import given, mode
from thinned import thinned

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.oracle.judge import judge
from saflite.oracle.policy import policies_for

AWAY = (0.0, 1.0, 0.0, 0.0, 47.3983519, 8.5456138, 60.0)  # 65 m north of home
STOPPED_S, FLOWN_S = 22.0, 45.0
PARACHUTE = {"CHUTE_ENABLED": 1.0, "CHUTE_TYPE": 10.0, "SERVO9_FUNCTION": 27.0, "SIM_PARA_ENABLE": 1.0}
STOPS = {
    "a parachute": given(STOPPED_S, "command", "MAV_CMD_DO_PARACHUTE", 2.0),
    "disarmed by force": given(STOPPED_S, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 0.0, 21196.0),
    "flight terminated": given(STOPPED_S, "command", "MAV_CMD_DO_FLIGHTTERMINATION", 1.0),
}
MODES = ("RTL", "LAND", "LOITER", "ALT_HOLD", "STABILIZE", "CIRCLE", "BRAKE", "GUIDED")


def broken(stop: Stimulus, before: str, after: str) -> dict[str, str]:
    """Fly away from home, then in a mode; stop, and be in another mode on the way down. What do rules say?"""
    stimuli = (
        given(0.5, "command", "MAV_CMD_DO_REPOSITION", *AWAY),
        mode(STOPPED_S - 6.0, before),
        stop,
        mode(STOPPED_S + 0.5, after),
    )
    scenario = Scenario(start=StartState(mode="GUIDED", altitude_m=60.0), time_limit_s=FLOWN_S)
    case = TestCase(target=Target(parameters=PARACHUTE), scenario=scenario, stimuli=stimuli)
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    found = judge(case, flight, record.trace, policies_for("reference")).verdicts
    return {one.policy: one.message for one in found if one.outcome == "violated"}


@pytest.mark.parametrize("how", thinned([(how,) for how in STOPS], each=2))
def test_nothing_is_asked_of_who_was_told_to_stop_the_motors(how: str) -> None:
    pairs = [(name, MODES[(place + 1) % len(MODES)]) for place, name in enumerate(MODES)]
    pairs += [(name, name) for name in MODES]
    told = {pair: broken(STOPS[how], *pair) for pair in pairs}
    assert not {pair: rules for pair, rules in told.items() if rules}
