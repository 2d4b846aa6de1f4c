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


SIDE = (3e-4, 0.0, 10.0), (3e-4, 4.5e-4, 10.0), (0.0, 4.5e-4, 10.0)  # legs to the north, east and south
EAST, SOUTH = 90.0, 180.0


@pytest.mark.parametrize(
    ("turn", "faces_deg"),
    [
        ((115, 45.0), (45.0, SOUTH)),
        ((115, 30.0, 0.0, -1.0, 1.0), (330.0, SOUTH)),
        ((115, 30.0, 0.0, 1.0, 1.0), (30.0, SOUTH)),
    ],
)
def test_a_heading_of_a_mission_is_of_the_leg_after_it(turn: tuple[float, ...], faces_deg: tuple[float, float]) -> None:
    legs = mission("turns", up(10.0), point(*SIDE[0]), turn, *(point(*place) for place in SIDE[1:]))
    target = Target(parameters={"OA_TYPE": 0.0, "WPNAV_SPEED": 300.0})
    record = fly_once(TestCase(target=target, scenario=Scenario(mission=legs, time_limit_s=90.0)))
    assert record.trace is not None
    items, yaw_deg = record.trace.array("mission_item"), record.trace.array("yaw_deg")
    for item, wanted_deg in zip((3, 4), faces_deg, strict=True):
        on_the_leg = yaw_deg[items == item]
        off_deg = (on_the_leg[len(on_the_leg) // 2] - wanted_deg + 180.0) % 360.0 - 180.0
        assert abs(off_deg) <= OFF_DEG, f"item {item}"


def test_an_order_to_turn_is_of_the_leg_it_was_given_on() -> None:
    legs = mission("legs", up(10.0), *(point(*place) for place in SIDE))
    target = Target(parameters={"OA_TYPE": 0.0, "WPNAV_SPEED": 300.0})
    turn = given(28.0, "command", "MAV_CMD_CONDITION_YAW", 200.0)
    record = fly_once(TestCase(target=target, scenario=Scenario(mission=legs, time_limit_s=90.0), stimuli=(turn,)))
    assert record.trace is not None
    items, yaw_deg = record.trace.array("mission_item"), record.trace.array("yaw_deg")
    assert items[round(28.0 / record.trace.step_s)] == 1, "the order is given on the first leg"
    first, second = yaw_deg[items == 1], yaw_deg[items == 2]
    assert abs(first[-20] - 200.0) <= OFF_DEG
    assert abs(second[len(second) // 2] - EAST) <= OFF_DEG
