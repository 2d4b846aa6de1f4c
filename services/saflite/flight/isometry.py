"""A test case turned about the take-off point by a right angle, or seen in a mirror: the same flight elsewhere.

A right angle, since what is given along north and east (offsets of the GPS) then only changes its name or its sign. The
mirror stands upright and along north: left and right are exchanged, east and west, clockwise and anticlockwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from msgspec.structs import replace

from saflite.contract.test_case import Mission, MissionItem, Obstacle, Scenario, Stimulus, TestCase
from saflite.flight.mission import MISSION_YAW_DEG, to_geographic, to_local
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
_TURNS_ITEM = 18  # the sign of its third number, a radius, says which way round
_WIND = "SIM_WIND_DIR"  # a direction, 0..360
_NORTH, _EAST = "SIM_GPS_GLITCH_X", "SIM_GPS_GLITCH_Y"
_SIDEWAYS = frozenset(
    {
        *(_EAST, "CIRCLE_RATE", "AHRS_TRIM_X", "INS_ACCOFFS_Y", "INS_GYROFFS_X", "INS_GYROFFS_Z", "COMPASS_OFS_Y"),
        *("GPS_POS1_Y", "SIM_MAG_OFFSET_Y", "SIM_ACC_BIAS_Y", "SIM_GYR_BIAS_X", "SIM_GYR_BIAS_Z"),
    }
)
"""What is positive to the right, clockwise or about an axis that lies in the mirror."""

_PULSES_US = 3000.0  # a pulse and its mirror image, about 1500 us
_SIDEWAYS_STICKS = ("RC1", "RC4")


class _Isometry(NamedTuple):
    """How (north m, east m), a heading (deg) and what has a name change; `sense` is -1 where clockwise does not stay.

    `start` is the heading that is added to that with which a flight begins, from both.
    """

    place: Callable[[float, float], tuple[float, float]]
    heading: Callable[[float], float]
    named: Callable[[str, float], tuple[str, float]]
    sense: float
    start: Callable[[float, float], float]


def turned(test_case: TestCase, defaults: Mapping[str, float]) -> TestCase:
    """Return the test case turned clockwise by a right angle; `defaults` are those of the target's inputs."""
    return _moved(test_case, defaults, _TURN)


def mirrored(test_case: TestCase, defaults: Mapping[str, float]) -> TestCase:
    """Return the test case with left and right exchanged; `defaults` are those of the target's inputs."""
    return _moved(test_case, defaults, _MIRROR)


def _turned_name(name: str, value: float) -> tuple[str, float]:
    if name == _WIND:
        return name, _TURN.heading(value)
    if name == _NORTH:
        return _EAST, value
    return (_NORTH, -value) if name == _EAST else (name, value)


def _mirrored_name(name: str, value: float) -> tuple[str, float]:
    if name == _WIND:
        return name, _MIRROR.heading(value)
    if name in _SIDEWAYS:
        return name, -value
    stick, _, what = name.partition("_")
    if stick not in _SIDEWAYS_STICKS or what not in ("", "MIN", "MAX", "TRIM"):
        return name, value
    other = {"MIN": f"{stick}_MAX", "MAX": f"{stick}_MIN"}
    return other.get(what, name), _PULSES_US - value


_TURN = _Isometry(
    place=lambda north_m, east_m: (-east_m, north_m),
    heading=lambda deg: (deg + TURN_DEG) % 360.0,
    named=_turned_name,
    sense=1.0,
    start=lambda heading_deg, _: heading_deg + TURN_DEG,
)
_MIRROR = _Isometry(
    place=lambda north_m, east_m: (north_m, -east_m),
    heading=lambda deg: -deg % 360.0,
    named=_mirrored_name,
    sense=-1.0,
    start=lambda heading_deg, stands_deg: -(heading_deg + 2.0 * stands_deg),
)


def _moved(test_case: TestCase, defaults: Mapping[str, float], by: _Isometry) -> TestCase:
    scenario = test_case.scenario
    kept = {name: value for name, value in defaults.items() if by.named(name, value)[1] != value}
    given = {**kept, **test_case.target.parameters}
    return replace(
        test_case,
        target=replace(test_case.target, parameters=dict(by.named(name, value) for name, value in given.items())),
        scenario=_scenario(scenario, by),
        stimuli=tuple(_stimulus(one, by) for one in test_case.stimuli),
        heading_deg=by.start(test_case.heading_deg, MISSION_YAW_DEG if scenario.mission else 0.0),
    )


def _place(lat_deg: float, lon_deg: float, home: tuple[float, float], by: _Isometry) -> tuple[float, float]:
    return to_geographic(*by.place(*to_local(lat_deg, lon_deg, *home)), *home)


def _stimulus(one: Stimulus, by: _Isometry) -> Stimulus:
    values = list(one.values)
    if one.kind in ("parameter", "sensor_fault", "stick") and len(values) == 1:
        name, value = by.named(one.name, values[0])
        return replace(one, name=name, values=(value,))
    if one.kind != "command" or not all(math.isfinite(value) for value in values):
        return one
    if one.name in _PLACES and len(values) >= 6 and (values[4] or values[5]):
        values[4:6] = _place(values[4], values[5], (HOME_LAT_DEG, HOME_LON_DEG), by)
    if one.name == _YAW and values:
        if values[3:4] in ([], [0.0]) and 0.0 <= values[0] <= 360.0:
            values[0] = by.heading(values[0])
        if len(values) > 2:
            values[2] = _sense(values[2], bool(values[3:4] and values[3]), by)
    return replace(one, values=tuple(values))


def _sense(clockwise: float, relative: bool, by: _Isometry) -> float:
    """Return the direction of a turn; 0 turns clockwise where it is by an angle, to a heading the shorter way."""
    if by.sense > 0.0:
        return clockwise
    return -(clockwise or 1.0) if relative else -clockwise


def _scenario(scenario: Scenario, by: _Isometry) -> Scenario:
    wind = scenario.wind
    return replace(
        scenario,
        mission=None if scenario.mission is None else _mission(scenario.mission, by),
        obstacles=tuple(_box(box, by) for box in scenario.obstacles),
        wind=replace(wind, from_deg=by.heading(wind.from_deg)),
    )


def _box(box: Obstacle, by: _Isometry) -> Obstacle:
    x_m, y_m = by.place(box.x_m, box.y_m)
    rotation_deg = box.rotation_deg + TURN_DEG if by.sense > 0.0 else -box.rotation_deg
    return replace(box, x_m=x_m, y_m=y_m, rotation_deg=rotation_deg)


def _mission(mission: Mission, by: _Isometry) -> Mission:
    home = mission.home_lat_deg, mission.home_lon_deg
    return replace(mission, items=tuple(_item(item, home, by) for item in mission.items))


def _item(item: MissionItem, home: tuple[float, float], by: _Isometry) -> MissionItem:
    params = list(item.params)
    lat_deg, lon_deg = params[4:6]
    if item.command in _PLACE_ITEMS and lat_deg and lon_deg:
        params[4:6] = _place(lat_deg, lon_deg, home, by)
    if item.command in _HEADED_ITEMS and params[3]:  # 0 stands for none
        params[3] = by.heading(params[3]) or 360.0
    if item.command == _YAW_ITEM:
        params[0] = (params[0] or 0.0) if params[3] else by.heading(params[0] or 0.0)
        params[2] = _sense(params[2] or 0.0, bool(params[3]), by)
    if item.command == _TURNS_ITEM and params[2]:
        params[2] *= by.sense
    return replace(item, params=tuple(params))
