"""Healthy flights around orders, missions and entries into a mode that rules once took for violations."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from stimuli import fault, given, mode, setting, stick

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

HOME = (47.3977419, 8.5455938)
FAR = (0.0, 1.0, 0.0, 0.0, 47.3987419, 8.5456138)
HOLDS = ("a-loiter1", "px-hold1", "px-position1")


def order(at_s: float, name: str, *values: float) -> Stimulus:
    return given(at_s, "command", f"MAV_CMD_{name}", *values)


def mission(name: str, *rows: tuple[float, ...]) -> Mission:
    """Rows of a MAV_CMD number and its seven numbers, the last ones 0 where they are left out."""
    items = tuple(MissionItem(command=int(row[0]), params=(*row[1:], *[0.0] * 7)[:7]) for row in rows)
    return Mission(name=name, home_lat_deg=HOME[0], home_lon_deg=HOME[1], home_alt_m=0.0, items=items)


def up(height_m: float) -> tuple[float, ...]:
    return (22, 0, 0, 0, 0, *HOME, height_m)


def point(north_deg: float, east_deg: float, height_m: float) -> tuple[float, ...]:
    return (16, 0, 0, 0, 0, HOME[0] + north_deg, HOME[1] + east_deg, height_m)


class Case(NamedTuple):
    """A flight from a start or of a mission, and the rules that must not be broken in it."""

    start: tuple[str, float] | Mission
    seconds: float
    parameters: dict[str, float]
    stimuli: tuple[Stimulus, ...]
    rules: tuple[str, ...]


CASES = {
    "a hold begins in a fast flight that began in a hold": Case(
        ("STABILIZE", 31.4),
        75.0,
        {},
        (
            mode(5.37, "CIRCLE"),
            mode(29.68, "ALT_HOLD"),
            stick(33.93, 1, 948.0),
            mode(43.72, "FLIP"),
            stick(46.5, 1, 1500.0),
            setting(47.87, "ANGLE_MAX", 1731.0),
            mode(47.88, "RTL"),
            mode(49.12, "LOITER"),
            setting(49.38, "ANGLE_MAX", 3995.0),
            stick(51.03, 2, 1680.0),
            stick(51.5, 2, 1500.0),
        ),
        HOLDS,
    ),
    "a speed too slow to fly at is ordered": Case(
        ("GUIDED", 20.0),
        60.0,
        {},
        (order(0.5, "DO_REPOSITION", *FAR, 20.0), order(24.0, "DO_CHANGE_SPEED", 0.0, 0.005), mode(26.0, "RTL")),
        ("a-rtl2", "place-reached"),
    ),
    "a return as slow as it may be": Case(
        ("GUIDED", 20.0),
        90.0,
        {"RTL_SPEED": 5.0},
        (order(0.5, "DO_REPOSITION", *FAR, 20.0), mode(26.0, "RTL")),
        ("a-rtl2",),
    ),
    "a landing reaches the height where it slows down": Case(
        ("LOITER", 15.0),
        25.0,
        {"WPNAV_SPEED_DN": 300.0, "PSC_JERK_XY": 20.0},
        (mode(0.5, "LAND"),),
        ("a-land2", "px-land1"),
    ),
    "an antenna is said to be far from the middle": Case(
        ("GUIDED", 8.0),
        110.0,
        {"GPS_POS1_X": 5.0, "GPS_POS1_Y": -5.0, "RTL_ALT": 800.0, "RTL_LOIT_TIME": 0.0},
        (order(0.5, "DO_REPOSITION", *FAR, 8.0), mode(26.0, "RTL")),
        ("estimate-true", "return-ends-at-home", "a-rtl2", "place-reached"),
    ),
    "a heading is ordered of a board said to be mounted askew": Case(
        ("GUIDED", 20.0),
        24.0,
        {},
        (setting(1.0, "AHRS_TRIM_X", 0.11), order(1.6, "CONDITION_YAW", 0.0, 0.0, 1.0, 0.0)),
        ("heading-reached",),
    ),
    "a landing without a position touches down in the wind, the position back": Case(
        ("LOITER", 30.0),
        75.0,
        {},
        (
            fault(0.5, "SIM_WIND_SPD", 8.0),
            fault(0.5, "SIM_WIND_DIR", 90.0),
            fault(1.0, "SIM_GPS_NUMSATS", 1.0),
            fault(5.0, "SIM_GPS_NUMSATS", 10.0),
        ),
        ("no-crash", "landing-stays"),
    ),
    "a circle is entered fast with a soft attitude": Case(
        ("ALT_HOLD", 30.0),
        50.0,
        {"ATC_INPUT_TC": 0.5},
        (stick(2.0, 2, 2000.0), stick(4.0, 2, 1500.0), mode(18.0, "CIRCLE")),
        ("circle-radius", "circle-rate"),
    ),
    "a mission is paused for good": Case(
        mission("paused", up(7.0), point(2e-4, 0.0, 7.0), point(0.0, 0.0, 7.0)),
        150.0,
        {},
        (order(24.0, "DO_PAUSE_CONTINUE", 0.0), mode(40.0, "AUTO")),
        ("mission-goes-on", "mission-in-order"),
    ),
    "a mission begins anew after its end": Case(
        mission("anew", up(7.0), (115, 67.0)),
        150.0,
        {},
        (order(50.0, "MISSION_START"),),
        ("mission-goes-on", "mission-in-order"),
    ),
    "a mission comes by the same place every 40 s": Case(
        mission("loop", up(10.0), point(2e-4, 0.0, 10.0), point(2e-4, 3e-4, 10.0), (177, 2, 2), point(0.0, 0.0, 10.0)),
        180.0,
        {},
        (),
        ("mission-goes-on", "mission-in-order"),
    ),
    "a mission climbs slowly between its way-points": Case(
        mission("steps", up(5.0), point(1e-4, 0.0, 20.0), point(0.0, 0.0, 5.0)),
        150.0,
        {"WPNAV_SPEED_UP": 50.0, "WPNAV_SPEED_DN": 50.0},
        (),
        ("mission-goes-on", "mission-in-order"),
    ),
    "a mission goes on straight down": Case(
        mission("down", up(40.0), point(-2.7e-5, 0.0, 5.0), point(2e-4, 0.0, 5.0)),
        150.0,
        {},
        (),
        ("mission-goes-on", "mission-in-order"),
    ),
    "a mission that asked for speed is left for a return": Case(
        mission("fast", up(10.0), (178, 1, 8), point(4e-3, 0.0, 10.0)),
        130.0,
        {"WPNAV_SPEED": 300.0, "RTL_ALT": 3000.0},
        (mode(75.0, "RTL"),),
        ("speed-limit",),
    ),
}


@pytest.mark.parametrize("name", list(CASES))
def test_nothing_is_broken(name: str) -> None:
    start, seconds, parameters, stimuli, rules = CASES[name]
    own = None if isinstance(start, Mission) else StartState(mode=start[0], altitude_m=start[1])
    flown = start if isinstance(start, Mission) else None
    scenario = Scenario(start=own, mission=flown, time_limit_s=seconds)
    case = TestCase(target=Target(parameters=parameters), scenario=scenario, stimuli=stimuli)
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    told = {
        verdict.policy: verdict.message
        for verdict in judge(case, flight, record.trace, rules).verdicts
        if verdict.outcome not in ("held", "vacuous")
    }
    assert not told
