"""Flights without any defect that rules once took for violations."""

from __future__ import annotations

import pytest
from stimuli import given

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import (
    Mission,
    MissionItem,
    Scenario,
    StartState,
    Stimulus,
    Target,
    TestCase,
    identity,
)
from saflite.oracle.judge import judge

START = StartState(mode="ALT_HOLD", altitude_m=50.0)
HEIGHT_RULES = ("a-alt-hold2", "px-altitude1")
STOP_RULES = ("a-rtl4", "px-rtl5")


def item(command: int, *where: float) -> MissionItem:
    return MissionItem(command=command, params=(0.0, 0.0, 0.0, 0.0, *(where or (0.0, 0.0, 0.0))))


UP_AND_BACK = Mission(
    name="up-and-back",
    home_lat_deg=47.3977419,
    home_lon_deg=8.5455938,
    home_alt_m=0.0,
    items=(item(22, 47.3977419, 8.5455938, 6.0), item(20)),
)
HIGH_UP_AND_BACK = Mission(
    name="high-up-and-back",
    home_lat_deg=47.3977419,
    home_lon_deg=8.5455938,
    home_alt_m=0.0,
    items=(item(22, 47.3977419, 8.5455938, 25.0), item(20)),
)
UP_AND_HIGHER = Mission(
    name="up-and-higher",
    home_lat_deg=47.3977419,
    home_lon_deg=8.5455938,
    home_alt_m=0.0,
    items=(item(22, 47.3977419, 8.5455938, 6.0), item(16, 47.3977419, 8.5455938, 30.0), item(20)),
)
Case = tuple[Scenario, dict[str, float], tuple[Stimulus, ...], tuple[str, ...]]
FLIP_UPON_FLIP: Case = (
    Scenario(start=START, time_limit_s=20.0),
    {},
    (given(1.0, "mode", "FLIP"), given(2.02, "mode", "FLIP")),
    HEIGHT_RULES,
)
ABOVE_THE_CEILING: Case = (
    Scenario(start=StartState(mode="ALT_HOLD", altitude_m=120.0), time_limit_s=20.0),
    {"FENCE_ENABLE": 1.0},
    (),
    HEIGHT_RULES,
)
CLIMBS_ON_AFTER_ITS_TAKEOFF: Case = (Scenario(mission=UP_AND_BACK, time_limit_s=32.0), {}, (), ("px-takeoff1",))
LAND_SPEED_IS_THE_GREATER: Case = (
    Scenario(start=StartState(mode="GUIDED", altitude_m=80.0), time_limit_s=12.0),
    {},
    (given(0.5, "mode", "LAND"), given(1.0, "parameter", "LAND_SPEED_HIGH", 2.0)),
    ("a-land1",),
)
ARMED_ANEW_ON_THE_GROUND: Case = (
    Scenario(start=StartState(mode="ACRO", altitude_m=0.0), time_limit_s=15.0),
    {},
    (
        given(0.5, "mode", "LAND"),
        given(11.43, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    STOP_RULES,
)
LANDS_OUT_OF_A_LOW_CIRCLE: Case = (
    Scenario(start=StartState(mode="CIRCLE", altitude_m=0.8), time_limit_s=20.0),
    {"LAND_SPEED": 150.0},
    (given(12.5, "mode", "LAND"),),
    ("no-crash", "upright", "a-land2"),
)
LANDS_WHERE_IT_WAS_FAST: Case = (
    Scenario(start=StartState(mode="GUIDED", altitude_m=1.0), time_limit_s=20.0),
    {"LAND_SPEED": 100.0},
    (
        given(0.5, "command", "MAV_CMD_DO_REPOSITION", -1.0, 0.0, 0.0, 0.0, 47.39731, 8.545341, 1.0),
        given(5.7, "mode", "LAND"),
    ),
    ("no-crash", "upright", "a-land2"),
)
TURNED_BY_THE_PILOT_AS_ITS_MISSION_CLIMBS: Case = (
    Scenario(mission=HIGH_UP_AND_BACK, time_limit_s=30.0),
    {},
    (given(20.7, "stick", "RC4", 2000.0),),
    ("a-auto1",),
)
STOPS_AT_ITS_PLACE_FROM_HIGH_SPEED: Case = (
    Scenario(start=StartState(mode="GUIDED", altitude_m=25.0), time_limit_s=25.0),
    {"WPNAV_ACCEL": 476.0},
    (
        given(0.5, "command", "MAV_CMD_DO_CHANGE_SPEED", 1.0, 16.0, -1.0, 0.0, 0.0, 0.0, 0.0),
        given(0.8, "command", "MAV_CMD_DO_REPOSITION", -1.0, 0.0, 0.0, 0.0, 47.3980963, 8.5457387, 30.0),
    ),
    ("place-reached",),
)
ARMED_ANEW_IN_THE_AIR: Case = (
    Scenario(start=StartState(mode="ACRO", altitude_m=200.0), time_limit_s=15.0),
    {},
    (
        given(0.5, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 0.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        given(1.1, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, 21196.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ),
    ("estimate-true", "a-alt-hold1"),
)
LINK_LOST_IN_A_CIRCLE: Case = (
    Scenario(start=StartState(mode="CIRCLE", altitude_m=20.0), time_limit_s=25.0),
    {},
    (
        given(0.5, "stick", "RC2", 1000.0),
        given(1.0, "sensor_fault", "SIM_RC_FAIL", 1.0),
        given(3.0, "mode", "CIRCLE"),
    ),
    ("a-circle1", "px-orbit1"),
)
LANDS_FASTER_THAN_IT_MAY_SINK: Case = (
    Scenario(start=StartState(mode="GUIDED", altitude_m=14.0), time_limit_s=45.0),
    {"LAND_SPEED": 150.0, "WPNAV_SPEED_DN": 50.0},
    (given(0.5, "mode", "RTL"),),
    ("climb-limit",),
)

MISSION_BEGUN_ANEW_ON_THE_WAY: Case = (
    Scenario(mission=UP_AND_HIGHER, time_limit_s=45.0),
    {},
    (given(28.0, "command", "MAV_CMD_MISSION_START", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),),
    ("px-takeoff1",),
)
TAKES_OFF_BEFORE_A_JUMP_IS_BELIEVED: Case = (
    Scenario(start=StartState(mode="GUIDED", altitude_m=0.0), time_limit_s=45.0),
    {},
    (
        given(0.5, "sensor_fault", "SIM_GPS_GLITCH_X", 60.0),
        given(9.2, "command", "MAV_CMD_NAV_TAKEOFF", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 60.0),
    ),
    ("takeoff-straight",),
)


@pytest.mark.parametrize(
    ("scenario", "parameters", "stimuli", "rules"),
    [
        FLIP_UPON_FLIP,
        ABOVE_THE_CEILING,
        CLIMBS_ON_AFTER_ITS_TAKEOFF,
        LAND_SPEED_IS_THE_GREATER,
        ARMED_ANEW_ON_THE_GROUND,
        LANDS_OUT_OF_A_LOW_CIRCLE,
        LANDS_WHERE_IT_WAS_FAST,
        TURNED_BY_THE_PILOT_AS_ITS_MISSION_CLIMBS,
        STOPS_AT_ITS_PLACE_FROM_HIGH_SPEED,
        ARMED_ANEW_IN_THE_AIR,
        LINK_LOST_IN_A_CIRCLE,
        LANDS_FASTER_THAN_IT_MAY_SINK,
        MISSION_BEGUN_ANEW_ON_THE_WAY,
        TAKES_OFF_BEFORE_A_JUMP_IS_BELIEVED,
    ],
)
def test_nothing_is_broken_where_the_manual_allows_it(
    scenario: Scenario, parameters: dict[str, float], stimuli: tuple[Stimulus, ...], rules: tuple[str, ...]
) -> None:
    case = TestCase(target=Target(parameters=parameters), scenario=scenario, stimuli=stimuli)
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    verdicts = judge(case, flight, record.trace, rules).verdicts
    assert {verdict.outcome for verdict in verdicts} <= {"held", "vacuous"}
