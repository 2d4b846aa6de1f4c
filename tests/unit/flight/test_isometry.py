"""A test case turned by a right angle or mirrored: what is where afterwards, and that repeated it comes back."""

from __future__ import annotations

import msgspec
import pytest

from saflite.contract.test_case import (
    Mission,
    MissionItem,
    Obstacle,
    Scenario,
    Stimulus,
    StimulusKind,
    Target,
    TestCase,
    Wind,
)
from saflite.flight.isometry import mirrored, turned
from saflite.flight.mission import to_geographic, to_local
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG

DEFAULTS = {"SIM_WIND_DIR": 180.0, "RTL_ALT": 1500.0}
AHEAD = to_geographic(50.0, 10.0, HOME_LAT_DEG, HOME_LON_DEG)


def case(*stimuli: Stimulus, scenario: Scenario | None = None, parameters: dict[str, float] | None = None) -> TestCase:
    return TestCase(target=Target(parameters=parameters or {}), scenario=scenario or Scenario(), stimuli=stimuli)


def given(kind: StimulusKind, name: str, *values: float) -> Stimulus:
    return Stimulus(at_s=1.0, kind=kind, name=name, values=values)


def test_a_place_ahead_lies_to_the_right() -> None:
    order = given("command", "MAV_CMD_DO_REPOSITION", -1, 0, 0, 0, *AHEAD, 20)
    (after,) = turned(case(order), DEFAULTS).stimuli
    north_m, east_m = to_local(after.values[4], after.values[5], HOME_LAT_DEG, HOME_LON_DEG)
    assert (north_m, east_m) == pytest.approx((-10.0, 50.0), abs=1e-3)
    assert after.values[6] == 20.0


def test_a_heading_turns_and_a_turn_stays() -> None:
    to, by = (given("command", "MAV_CMD_CONDITION_YAW", 300, 0, 1, relative) for relative in (0, 1))
    after = turned(case(to, by), DEFAULTS).stimuli
    assert [one.values[0] for one in after] == [30.0, 300.0]


def test_offsets_of_the_gps_change_name_and_sign() -> None:
    north, east = given("sensor_fault", "SIM_GPS_GLITCH_X", 40), given("parameter", "SIM_GPS_GLITCH_Y", 30)
    after = turned(case(north, east, parameters={"SIM_GPS_GLITCH_Y": 7.0}), DEFAULTS)
    assert [(one.name, one.values) for one in after.stimuli] == [
        ("SIM_GPS_GLITCH_Y", (40,)),
        ("SIM_GPS_GLITCH_X", (-30,)),
    ]
    assert after.target.parameters == {"SIM_GPS_GLITCH_X": -7.0, "SIM_WIND_DIR": 270.0}


def test_wind_boxes_and_the_start_turn_along() -> None:
    scenario = Scenario(
        wind=Wind(mean_mps=5.0, from_deg=350.0),
        obstacles=(Obstacle(length_m=2.0, width_m=3.0, height_m=10.0, x_m=20.0, y_m=5.0, rotation_deg=10.0),),
    )
    after = turned(case(scenario=scenario), DEFAULTS)
    (box,) = after.scenario.obstacles
    assert (box.x_m, box.y_m, box.rotation_deg) == (-5.0, 20.0, 100.0)
    assert after.scenario.wind.from_deg == 80.0
    assert after.heading_deg == 90.0


def test_the_places_of_a_mission_turn_along() -> None:
    items = (
        MissionItem(command=16, params=(0.0, 0.0, 0.0, 0.0, *AHEAD, 15.0)),
        MissionItem(command=115, params=(90.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)),
        MissionItem(command=115, params=(90.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)),
        MissionItem(command=20, params=(0.0,) * 7),
    )
    mission = Mission(name="m", home_lat_deg=HOME_LAT_DEG, home_lon_deg=HOME_LON_DEG, home_alt_m=0.0, items=items)
    after = turned(case(scenario=Scenario(mission=mission)), DEFAULTS).scenario.mission
    assert after is not None
    lat_deg, lon_deg = after.items[0].params[4:6]
    assert lat_deg is not None
    assert lon_deg is not None
    assert to_local(lat_deg, lon_deg, HOME_LAT_DEG, HOME_LON_DEG) == pytest.approx((-10.0, 50.0), abs=1e-3)
    assert [item.params[0] for item in after.items[1:]] == [180.0, 90.0, 0.0]


def test_numbers_that_are_none_stay() -> None:
    order = given("command", "MAV_CMD_DO_REPOSITION", -1, 0, 0, 0, float("nan"), 8.5, 20)
    assert turned(case(order), DEFAULTS).stimuli[0].values[5] == 8.5


def test_four_turns_give_it_back() -> None:
    order = given("command", "MAV_CMD_DO_REPOSITION", -1, 0, 0, 0, *AHEAD, 20)
    glitch, stick = given("sensor_fault", "SIM_GPS_GLITCH_X", 40), given("stick", "RC1", 1700)
    scenario = Scenario(wind=Wind(mean_mps=3.0, from_deg=10.0))
    first = case(order, glitch, stick, scenario=scenario, parameters={"SIM_WIND_DIR": 20.0})
    after = first
    for _ in range(4):
        after = turned(after, DEFAULTS)
    assert after.stimuli[0].values == pytest.approx(order.values, abs=1e-9)
    assert after.stimuli[1:] == first.stimuli[1:]
    assert after.scenario.wind == first.scenario.wind
    assert after.target.parameters == {"SIM_WIND_DIR": 20.0}
    assert msgspec.structs.replace(after, stimuli=(), heading_deg=0.0).scenario == scenario


def test_in_the_mirror_a_place_to_the_right_lies_to_the_left() -> None:
    order = given("command", "MAV_CMD_DO_REPOSITION", -1, 0, 0, 0, *AHEAD, 20)
    (after,) = mirrored(case(order), DEFAULTS).stimuli
    north_m, east_m = to_local(after.values[4], after.values[5], HOME_LAT_DEG, HOME_LON_DEG)
    assert (north_m, east_m) == pytest.approx((50.0, -10.0), abs=1e-3)


@pytest.mark.parametrize(
    ("numbers", "after"),
    [
        ((300, 0, 1, 0), (60, 0, -1, 0)),
        ((30, 0, -1, 1), (30, 0, 1, 1)),
        ((30, 0, 0, 1), (30, 0, -1, 1)),  # without a direction a turn is clockwise
        ((300, 0, 0, 0), (60, 0, 0, 0)),  # to a heading, the shorter way round
        ((-5, 0, 1, 0), (-5, 0, -1, 0)),  # refused, and so it is in the mirror
    ],
)
def test_in_the_mirror_a_turn_goes_the_other_way(numbers: tuple[float, ...], after: tuple[float, ...]) -> None:
    (turn,) = mirrored(case(given("command", "MAV_CMD_CONDITION_YAW", *numbers)), DEFAULTS).stimuli
    assert turn.values == after
    items = (MissionItem(command=115, params=(*numbers, 0.0, 0.0, 0.0)),)
    mission = Mission(name="m", home_lat_deg=HOME_LAT_DEG, home_lon_deg=HOME_LON_DEG, home_alt_m=0.0, items=items)
    flown = mirrored(case(scenario=Scenario(mission=mission)), DEFAULTS).scenario.mission
    assert flown is not None
    assert flown.items[0].params[1:4] == after[1:]


def test_in_the_mirror_sticks_and_their_calibrations_change_sides() -> None:
    low, roll, pitch = given("parameter", "RC1_MIN", 1200), given("stick", "RC1", 1700), given("stick", "RC2", 1700)
    after = mirrored(case(low, roll, pitch, parameters={"RC4_TRIM": 1480.0}), {"RC1_MIN": 1100.0, "RC1_MAX": 1900.0})
    assert [(one.name, one.values) for one in after.stimuli] == [
        ("RC1_MAX", (1800,)),
        ("RC1", (1300,)),
        ("RC2", (1700,)),
    ]
    assert after.target.parameters == {"RC1_MAX": 1900.0, "RC1_MIN": 1100.0, "RC4_TRIM": 1520.0}


def test_in_the_mirror_what_is_off_to_a_side_is_off_to_the_other() -> None:
    wind, box = (
        Wind(mean_mps=5.0, from_deg=350.0),
        Obstacle(length_m=2.0, width_m=3.0, height_m=10.0, x_m=20.0, y_m=5.0, rotation_deg=10.0),
    )
    glitch = given("sensor_fault", "SIM_GPS_GLITCH_Y", 40)
    after = mirrored(case(glitch, scenario=Scenario(wind=wind, obstacles=(box,))), {**DEFAULTS, "CIRCLE_RATE": 20.0})
    (moved,) = after.scenario.obstacles
    assert (moved.x_m, moved.y_m, moved.rotation_deg) == (20.0, -5.0, -10.0)
    assert after.scenario.wind.from_deg == 10.0
    assert after.stimuli[0].values == (-40,)
    assert after.target.parameters == {"CIRCLE_RATE": -20.0}


def test_a_mission_begins_nose_east_and_in_the_mirror_nose_west() -> None:
    mission = Mission(name="m", home_lat_deg=HOME_LAT_DEG, home_lon_deg=HOME_LON_DEG, home_alt_m=0.0, items=())
    after = mirrored(case(scenario=Scenario(mission=mission)), DEFAULTS)
    assert (after.heading_deg + 90.0) % 360.0 == 270.0


def test_two_mirrors_give_it_back() -> None:
    order = given("command", "MAV_CMD_DO_REPOSITION", -1, 0, 0, 0, *AHEAD, 20)
    turn, stick = given("command", "MAV_CMD_CONDITION_YAW", 30, 0, 1, 0), given("stick", "RC4", 1700)
    first = case(order, turn, stick, scenario=Scenario(wind=Wind(mean_mps=3.0, from_deg=10.0)))
    after = mirrored(mirrored(first, DEFAULTS), DEFAULTS)
    assert after.stimuli[0].values == pytest.approx(order.values, abs=1e-9)
    assert after.stimuli[1:] == first.stimuli[1:]
    assert after.scenario.wind == first.scenario.wind
