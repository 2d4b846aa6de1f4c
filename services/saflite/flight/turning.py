"""A test case turned about the take-off point by a right angle: the same flight, heading elsewhere.

A right angle, since what is given along north and east (offsets of the GPS) then only changes its name or its sign.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec.structs import replace

from saflite.contract.test_case import Mission, MissionItem, Obstacle, Scenario, Stimulus, TestCase
from saflite.flight.mission import to_geographic, to_local
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG

TURN_DEG = 90.0
_PLACES = frozenset(
    {
        *("MAV_CMD_DO_REPOSITION", "MAV_CMD_DO_SET_HOME", "MAV_CMD_DO_SET_ROI", "MAV_CMD_DO_SET_ROI_LOCATION"),
        *("MAV_CMD_NAV_LAND", "MAV_CMD_NAV_TAKEOFF", "MAV_CMD_NAV_WAYPOINT", "MAV_CMD_NAV_SPLINE_WAYPOINT"),
        *("MAV_CMD_NAV_LOITER_TIME", "MAV_CMD_NAV_LOITER_TURNS", "MAV_CMD_NAV_LOITER_UNLIM"),
    }
)
_PLACE_ITEMS = frozenset({16, 17, 18, 19, 21, 22, 82, 195, 201})
_HEADED_ITEMS = frozenset({16, 17, 19, 21, 22, 82})  # the fourth number is a heading
_YAW, _YAW_ITEM = "MAV_CMD_CONDITION_YAW", 115
_ROUND = frozenset({"SIM_WIND_DIR"})  # a direction, 0..360
_NORTH, _EAST = "SIM_GPS_GLITCH_X", "SIM_GPS_GLITCH_Y"


def turned(test_case: TestCase, defaults: Mapping[str, float]) -> TestCase:
    """Return the test case turned clockwise by a right angle; `defaults` are those of the target's inputs."""
    directions = {name: value for name, value in defaults.items() if name in _ROUND}
    given = {**directions, **test_case.target.parameters}
    parameters = dict(_named(name, value) for name, value in given.items())
    return replace(
        test_case,
        target=replace(test_case.target, parameters=parameters),
        scenario=_scenario(test_case.scenario),
        stimuli=tuple(_stimulus(one) for one in test_case.stimuli),
        heading_deg=test_case.heading_deg + TURN_DEG,
    )


def _clockwise(direction_deg: float) -> float:
    return (direction_deg + TURN_DEG) % 360.0


def _named(name: str, value: float) -> tuple[str, float]:
    if name in _ROUND:
        return name, _clockwise(value)
    if name == _NORTH:
        return _EAST, value
    return (_NORTH, -value) if name == _EAST else (name, value)


def _place(lat_deg: float, lon_deg: float, home: tuple[float, float]) -> tuple[float, float]:
    north_m, east_m = to_local(lat_deg, lon_deg, *home)
    return to_geographic(-east_m, north_m, *home)


def _stimulus(one: Stimulus) -> Stimulus:
    values = list(one.values)
    if one.kind in ("parameter", "sensor_fault") and len(values) == 1:
        name, value = _named(one.name, values[0])
        return replace(one, name=name, values=(value,))
    if one.kind != "command" or not all(math.isfinite(value) for value in values):
        return one
    if one.name in _PLACES and len(values) >= 6 and (values[4] or values[5]):
        values[4:6] = _place(values[4], values[5], (HOME_LAT_DEG, HOME_LON_DEG))
    if one.name == _YAW and values and values[3:4] in ([], [0.0]) and 0.0 <= values[0] <= 360.0:
        values[0] = _clockwise(values[0])
    return replace(one, values=tuple(values))


def _scenario(scenario: Scenario) -> Scenario:
    wind = scenario.wind
    return replace(
        scenario,
        mission=None if scenario.mission is None else _mission(scenario.mission),
        obstacles=tuple(_box(box) for box in scenario.obstacles),
        wind=replace(wind, from_deg=_clockwise(wind.from_deg)),
    )


def _box(box: Obstacle) -> Obstacle:
    return replace(box, x_m=-box.y_m, y_m=box.x_m, rotation_deg=box.rotation_deg + TURN_DEG)


def _mission(mission: Mission) -> Mission:
    home = mission.home_lat_deg, mission.home_lon_deg
    return replace(mission, items=tuple(_item(item, home) for item in mission.items))


def _item(item: MissionItem, home: tuple[float, float]) -> MissionItem:
    params = list(item.params)
    lat_deg, lon_deg = params[4:6]
    if item.command in _PLACE_ITEMS and lat_deg and lon_deg:
        params[4:6] = _place(lat_deg, lon_deg, home)
    if item.command in _HEADED_ITEMS and params[3]:  # 0 stands for none
        params[3] = _clockwise(params[3]) or 360.0
    if item.command == _YAW_ITEM and not params[3]:
        params[0] = _clockwise(params[0] or 0.0)
    return replace(item, params=tuple(params))
