"""An order to turn ends with the mode it was given in: a mission entered afterwards looks along its legs.

After ArduCopter mode_auto.cpp: a way-point begun takes the nose back to where WP_YAW_BEHAVIOR has it.
"""

from __future__ import annotations

import pytest
from stimuli import given, mode, stick
from test_sound_orders import mission, point, up

from saflite.conformance.flying import fly_once
from saflite.contract.signals import MODES
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase

LEFT_S, ENTERED_S, LOOKS_S, FLOWN_S, OFF_DEG = 22.0, 27.0, 40.0, 42.0, 12.0
NORTH = mission("north", up(10.0), point(0.003, 0.0, 10.0))
TURNS: dict[str, tuple[Stimulus, ...]] = {
    "the pilot turns as the mission is left": (stick(20.0, 4, 1800.0), mode(LEFT_S, "LOITER"), stick(23.0, 4, 1500.0)),
    "ordered in GUIDED": (mode(20.0, "GUIDED"), given(21.0, "command", "MAV_CMD_CONDITION_YAW", 200.0)),
    "ordered in AUTO": (given(20.0, "command", "MAV_CMD_CONDITION_YAW", 200.0), mode(LEFT_S, "LOITER")),
}


@pytest.mark.parametrize("how", list(TURNS))
def test_a_mission_entered_does_not_heed_turns_ordered_before(how: str) -> None:
    scenario = Scenario(mission=NORTH, time_limit_s=FLOWN_S)
    stimuli = (*TURNS[how], mode(ENTERED_S, "AUTO"))
    record = fly_once(TestCase(target=Target(parameters={"OA_TYPE": 0.0}), scenario=scenario, stimuli=stimuli))
    assert record.trace is not None
    at = round(LOOKS_S / record.trace.step_s)
    assert record.trace.array("mode")[at] == MODES["AUTO"]
    assert record.trace.array("mission_item")[at] == 1
    yaw_deg = float(record.trace.array("yaw_deg")[at])
    assert abs((yaw_deg + 180.0) % 360.0 - 180.0) <= OFF_DEG
