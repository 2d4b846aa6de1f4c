"""Healthy flights with settings at the ends of their ranges, or set on the way: rules once took them for violations."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from stimuli import fault, given, mode, setting, stick

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.oracle.judge import judge

RETURNS = ("a-rtl1", "px-rtl1", "a-rtl2")
FAR = (0.0, 1.0, 0.0, 0.0, 47.3987419, 8.5456138)  # 110 m north


def goto(at_s: float, place: tuple[float, ...], altitude_m: float) -> Stimulus:
    return given(at_s, "command", "MAV_CMD_DO_REPOSITION", *place, altitude_m)


def armed(at_s: float) -> Stimulus:
    return given(at_s, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, 21196.0)


def disarmed(at_s: float) -> Stimulus:
    return given(at_s, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 0.0)


class Case(NamedTuple):
    """A flight from a start, and the rules that must not be broken in it."""

    start: tuple[str, float]
    seconds: float
    parameters: dict[str, float]
    stimuli: tuple[Stimulus, ...]
    rules: tuple[str, ...]


CASES = {
    "a ceiling is lifted when a return below it has begun": Case(
        ("GUIDED", 6.0),
        70.0,
        {"FENCE_ENABLE": 1.0, "FENCE_ALT_MAX": 10.0},
        (goto(0.5, FAR, 6.0), mode(28.0, "RTL"), setting(31.0, "FENCE_ALT_MAX", 100.0)),
        RETURNS,
    ),
    "a ceiling is lifted when a return above it has begun": Case(
        ("GUIDED", 60.0),
        60.0,
        {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 0.0, "WPNAV_SPEED": 300.0},
        (
            goto(0.5, FAR, 60.0),
            setting(29.0, "FENCE_ALT_MAX", 30.0),
            mode(30.0, "RTL"),
            setting(31.0, "FENCE_ALT_MAX", 100.0),
        ),
        RETURNS,
    ),
    "a return begins in a sink that is slowly stopped": Case(
        ("GUIDED", 14.0),
        50.0,
        {"PILOT_SPEED_DN": 300.0, "WPNAV_ACCEL_Z": 50.0, "RTL_ALT": 4000.0},
        (goto(0.5, FAR, 30.0), mode(28.0, "ALT_HOLD"), stick(28.1, 3, 1000.0), mode(34.0, "RTL")),
        RETURNS,
    ),
    "a return begins in a climb that is slowly stopped": Case(
        ("GUIDED", 30.0),
        60.0,
        {"PILOT_SPEED_UP": 500.0, "WPNAV_ACCEL_Z": 50.0, "WPNAV_SPEED": 300.0},
        (goto(0.5, FAR, 30.0), mode(30.0, "ALT_HOLD"), stick(30.1, 3, 2000.0), mode(40.0, "RTL")),
        RETURNS,
    ),
    "a landing begins in a climb that is slowly stopped": Case(
        ("ALT_HOLD", 30.0),
        30.0,
        {"WPNAV_ACCEL_Z": 50.0},
        (stick(0.5, 3, 2000.0), mode(8.0, "LAND")),
        ("a-land1",),
    ),
    "a low landing begins in a climb that is slowly stopped": Case(
        ("ALT_HOLD", 10.0),
        30.0,
        {"WPNAV_ACCEL_Z": 50.0, "LAND_ALT_LOW": 10000.0},
        (stick(0.5, 3, 2000.0), mode(8.0, "LAND")),
        ("a-land2", "px-land1"),
    ),
    "a noisy receiver falls silent as the estimate is about to be lost": Case(
        ("ALT_HOLD", 30.0),
        20.0,
        {"COM_POS_FS_DELAY": 6.0, "FS_EKF_THRESH": 0.6},
        (fault(3.0, "SIM_GPS_NOISE", 2.0), fault(15.0, "SIM_GPS_NUMSATS", 2.0)),
        ("failsafe-not-early",),
    ),
    "three sticks are held, and the nose turns under the lean": Case(
        ("ALT_HOLD", 60.0),
        9.0,
        {},
        (stick(1.0, 1, 2000.0), stick(1.0, 2, 1400.0), stick(1.0, 4, 1750.0)),
        ("stick-scale",),
    ),
    "a place is held with the least gains and a level that leans": Case(
        ("GUIDED", 20.0),
        50.0,
        {"PSC_POSXY_P": 0.5, "PSC_VELXY_P": 1.0, "PSC_VELXY_I": 0.02, "PSC_VELXY_IMAX": 100.0, "AHRS_TRIM_Y": 0.17},
        (goto(1.0, (0.0, 1.0, 0.0, 0.0, 47.39792, 8.5456138), 20.0),),
        ("place-reached",),
    ),
    "the barometer goes wrong on the ground once it is armed": Case(
        ("STABILIZE", 0.0), 24.0, {"DISARM_DELAY": 0.0}, (fault(3.0, "SIM_BARO_GLITCH", 20.0),), ("estimate-true",)
    ),
    "it is armed as the barometer goes wrong": Case(
        ("STABILIZE", 0.0),
        24.0,
        {"DISARM_DELAY": 0.0, "ARMING_CHECK": 0.0},
        (disarmed(3.0), fault(6.0, "SIM_BARO_GLITCH", 20.0), armed(6.1)),
        ("estimate-true",),
    ),
    "a return waits as long over home as it was told": Case(
        ("GUIDED", 30.0), 60.0, {"RTL_LOIT_TIME": 60000.0}, (mode(0.5, "RTL"),), ("a-rtl3",)
    ),
    "a battery failsafe begins a climb over home": Case(
        ("GUIDED", 30.0),
        60.0,
        {"RTL_CLIMB_MIN": 3000.0, "BATT_LOW_VOLT": 10.5, "WPNAV_SPEED_UP": 50.0},
        (fault(10.0, "SIM_BATT_VOLTAGE", 9.0),),
        ("a-rtl3",),
    ),
    "the height a return ends at is set to 0 when it hovers there": Case(
        ("GUIDED", 15.0),
        70.0,
        {"RTL_ALT_FINAL": 500.0, "DISARM_DELAY": 0.0},
        (mode(0.5, "RTL"), setting(25.0, "RTL_ALT_FINAL", 0.0)),
        ("a-rtl4", "px-rtl5", "return-final-height"),
    ),
    "a return with a final height begins in a sink": Case(
        ("ALT_HOLD", 21.0),
        25.0,
        {"RTL_ALT_FINAL": 1000.0, "RTL_ALT": 200.0, "PILOT_SPEED_DN": 300.0, "WPNAV_ACCEL_Z": 50.0},
        (stick(0.5, 3, 1000.0), mode(6.0, "RTL")),
        ("return-final-height",),
    ),
    "a storm drops before a landing ends": Case(
        ("LOITER", 12.0),
        80.0,
        {},
        (mode(6.0, "RTL"), fault(19.0, "SIM_WIND_SPD", 15.0), fault(23.7, "SIM_WIND_SPD", 0.0)),
        ("a-rtl4", "px-rtl5"),
    ),
    "the nose turns fast where a circle is shrunk to a point": Case(
        ("CIRCLE", 20.0),
        30.0,
        {"ATC_SLEW_YAW": 18000.0},
        (stick(0.5, 2, 1000.0),),
        ("a-circle7",),
    ),
    "the nose catches up with a circle": Case(
        ("CIRCLE", 20.0),
        30.0,
        {"ATC_SLEW_YAW": 500.0},
        (setting(12.0, "ATC_SLEW_YAW", 18000.0),),
        ("a-circle7",),
    ),
    "a slow circle is shrunk": Case(
        ("GUIDED", 20.0),
        36.0,
        {"CIRCLE_RATE": 6.5, "CIRCLE_RADIUS": 2600.0},
        (mode(0.5, "CIRCLE"), stick(8.5, 2, 1000.0)),
        ("a-circle1", "px-orbit1"),
    ),
    "a compass was off by its field for 9 s": Case(
        ("GUIDED", 30.0),
        90.0,
        {},
        (fault(12.0, "SIM_MAG_OFFSET_Y", 500.0), fault(21.0, "SIM_MAG_OFFSET_Y", 0.0), mode(31.0, "ALT_HOLD")),
        ("levels-itself",),
    ),
    "a fast turn is slowed down by its setting": Case(
        ("LOITER", 30.0), 20.0, {}, (stick(0.5, 4, 2000.0), setting(12.0, "PILOT_Y_RATE", 1.0)), ("stick-acts",)
    ),
    "a board mounted askew takes what little lean is set": Case(
        ("ALT_HOLD", 30.0),
        12.0,
        {"ANGLE_MAX": 1000.0, "AHRS_TRIM_X": 0.1745},
        (stick(2.0, 1, 2000.0),),
        ("stick-acts", "angle-max"),
    ),
    "an order to turn was given in an earlier stay": Case(
        ("GUIDED", 30.0),
        50.0,
        {"ATC_SLEW_YAW": 500.0},
        (
            given(0.5, "command", "MAV_CMD_CONDITION_YAW", 180.0, 0.0, 1.0, 0.0),
            mode(3.0, "LOITER"),
            mode(8.0, "GUIDED"),
        ),
        ("a-guided1",),
    ),
    "a pilot's take-off climbs on with the stick let go": Case(
        ("ALT_HOLD", 0.0),
        40.0,
        {"PILOT_TKOFF_ALT": 1000.0, "PILOT_SPEED_UP": 50.0},
        (stick(0.5, 3, 2000.0), stick(6.0, 3, 1500.0)),
        ("a-alt-hold2", "px-altitude1"),
    ),
    "a hold brakes as slowly as it may": Case(
        ("GUIDED", 30.0),
        60.0,
        {"LOIT_BRK_ACCEL": 25.0, "LOIT_SPEED": 100.0, "WPNAV_SPEED": 1500.0},
        (goto(0.5, (0.0, 1.0, 0.0, 0.0, 47.4017419, 8.5456138), 30.0), mode(15.0, "LOITER")),
        ("speed-limit",),
    ),
    "a stick is nearly full": Case(
        ("ALT_HOLD", 30.0), 16.0, {"PILOT_SPEED_UP": 500.0}, (stick(0.5, 3, 1951.0),), ("pilot-climb-speed",)
    ),
    "the stick turns from full down to full up": Case(
        ("ALT_HOLD", 90.0),
        45.0,
        {"PILOT_SPEED_UP": 500.0, "PILOT_SPEED_DN": 300.0, "PILOT_ACCEL_Z": 50.0, "WPNAV_ACCEL_Z": 50.0},
        (stick(0.5, 3, 1000.0), stick(15.0, 3, 2000.0)),
        ("pilot-climb-speed",),
    ),
    "a return that lands is slowed down": Case(
        ("GUIDED", 60.0),
        32.0,
        {"LAND_SPEED_HIGH": 300.0, "RTL_LOIT_TIME": 0.0},
        (mode(0.5, "RTL"), setting(8.0, "LAND_SPEED_HIGH", 50.0)),
        ("climb-limit",),
    ),
    "a brake is made slower when it has begun": Case(
        ("GUIDED", 30.0),
        40.0,
        {"WPNAV_SPEED": 1500.0, "WPNAV_ACCEL": 500.0, "ANGLE_MAX": 4500.0},
        (
            goto(0.5, (0.0, 1.0, 0.0, 0.0, 47.4017419, 8.5456138), 30.0),
            mode(15.0, "BRAKE"),
            setting(15.3, "ANGLE_MAX", 1000.0),
            setting(15.3, "WPNAV_ACCEL", 100.0),
        ),
        ("a-brake1",),
    ),
    "a take-off gathers its speed slowly": Case(
        ("GUIDED", 0.0),
        25.0,
        {"WPNAV_SPEED_UP": 500.0, "WPNAV_ACCEL_Z": 50.0},
        (given(1.0, "command", "MAV_CMD_NAV_TAKEOFF", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 90.0),),
        ("px-takeoff2", "takeoff-climbs"),
    ),
    "a flip is broken off half-way": Case(
        ("ALT_HOLD", 40.0),
        12.0,
        {},
        (stick(1.0, 3, 2000.0), stick(3.9, 3, 1500.0), mode(4.3, "FLIP"), mode(4.8, "ALT_HOLD")),
        ("a-alt-hold2", "px-altitude1"),
    ),
    "a full lean is held until the motors do not carry it": Case(
        ("ALT_HOLD", 15.0),
        40.0,
        {"ANGLE_MAX": 4500.0},
        (setting(2.0, "AHRS_TRIM_X", -0.1745), stick(14.0, 1, 2000.0)),
        ("a-alt-hold2", "px-altitude1"),
    ),
    "it is armed while the barometer is off, which stays so": Case(
        ("STABILIZE", 0.0),
        60.0,
        {},
        (disarmed(0.5), fault(1.0, "SIM_BARO_GLITCH", 5.0), armed(35.0)),
        ("a-alt-hold1", "estimate-true"),
    ),
    "it is armed while the barometer is off, which ends": Case(
        ("STABILIZE", 0.0),
        85.0,
        {"DISARM_DELAY": 0.0},
        (
            disarmed(0.5),
            fault(1.0, "SIM_BARO_GLITCH", 8.0),
            armed(35.0),
            fault(36.0, "SIM_BARO_GLITCH", 0.0),
        ),
        ("a-alt-hold1", "estimate-true"),
    ),
    "it is armed in the air, then loses its position": Case(
        ("ALT_HOLD", 200.0),
        25.0,
        {"FS_EKF_ACTION": 2.0},
        (
            given(0.5, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 0.0, 21196.0),
            given(1.1, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0, 21196.0),
            fault(3.0, "SIM_GPS_DISABLE", 1.0),
        ),
        ("a-gps-fs2",),
    ),
    "it touches the ground that its barometer places 25 m lower": Case(
        ("ACRO", 50.0),
        75.0,
        {},
        (fault(0.5, "SIM_BARO_GLITCH", 25.0), mode(25.0, "LAND")),
        ("a-land1", "a-land2", "px-land1", "landing-stays"),
    ),
    "a fence is switched on by a number that is no whole one": Case(
        ("STABILIZE", 60.0),
        20.0,
        {"FENCE_ENABLE": 0.9},
        (stick(0.5, 3, 1700.0),),
        ("failsafe-has-cause",),
    ),
}


@pytest.mark.parametrize("name", list(CASES))
def test_nothing_is_broken(name: str) -> None:
    start, seconds, parameters, stimuli, rules = CASES[name]
    scenario = Scenario(start=StartState(mode=start[0], altitude_m=start[1]), time_limit_s=seconds)
    case = TestCase(target=Target(parameters=parameters), scenario=scenario, stimuli=stimuli)
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    told = {
        verdict.policy: verdict.message
        for verdict in judge(case, flight, record.trace, rules).verdicts
        if verdict.outcome not in ("held", "vacuous")
    }
    assert not told
