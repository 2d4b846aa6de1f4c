"""Forty reference flights: every built-in mission among boxes, every defect's trigger, and inputs of every kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

import msgspec

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, StimulusKind, Target, TestCase, Wind
from saflite.flight.autopilots.reference.defects import TABLE, trigger
from saflite.flight.mission import waypoints

MISSIONS = range(1, 8)
FLIGHTS = 40

Inputs = tuple[tuple[float, StimulusKind, str, tuple[float, ...]], ...]


def cases() -> dict[str, TestCase]:
    """Return the reference flights by name."""
    missions = {f"mission-{number}": mission_case(number) for number in MISSIONS}
    triggers = {f"defect-{name}": trigger(name) for name in TABLE}
    return missions | triggers | inputs_cases()


def mission_case(number: int) -> TestCase:
    """Return the template of a mission's avoidance campaign with one to three boxes close to its legs."""
    plain = template(load_campaign(f"avoidance-m{number}"))
    boxes = tuple(box_near_the_path(plain, number, place) for place in range(1 + number % 3))
    return msgspec.structs.replace(plain, scenario=msgspec.structs.replace(plain.scenario, obstacles=boxes))


def box_near_the_path(test_case: TestCase, number: int, place: int) -> Obstacle:
    """Draw a box beside one of the longer legs of the mission, near enough to be flown around."""
    mission = test_case.scenario.mission
    assert mission is not None
    rng = derive(2024, "golden boxes", number, place)
    points = [(point.x_m, point.y_m) for point in waypoints(mission)]
    legs = [pair for pair in pairwise(points) if math.dist(*pair) > 10.0]
    (x0, y0), (x1, y1) = legs[place % len(legs)]
    along, off_m = rng.uniform(0.35, 0.65), rng.uniform(-4.0, 4.0)
    course = math.atan2(y1 - y0, x1 - x0)
    return Obstacle(
        length_m=round(float(rng.uniform(3.0, 9.0)), 2),
        width_m=round(float(rng.uniform(3.0, 9.0)), 2),
        height_m=round(float(rng.uniform(15.0, 25.0)), 2),
        x_m=round(float(x0 + along * (x1 - x0) - off_m * math.sin(course)), 2),
        y_m=round(float(y0 + along * (y1 - y0) + off_m * math.cos(course)), 2),
        rotation_deg=round(float(rng.uniform(0.0, 90.0)), 1),
    )


def target_of(parameters: Mapping[str, float]) -> Target:
    """Return the reference vehicle with these parameters and no defect."""
    return Target(parameters=dict(parameters))


def inputs_case(
    start: StartState, time_s: float, inputs: Inputs, wind: Wind | None = None, parameters: Mapping[str, float] = {}
) -> TestCase:
    """Return a flight without mission: a start state and timed inputs."""
    return TestCase(
        target=target_of(parameters),
        scenario=Scenario(start=start, wind=wind or Wind(), time_limit_s=time_s),
        stimuli=tuple(Stimulus(at_s=at, kind=kind, name=name, values=values) for at, kind, name, values in inputs),
        rng_seed=7,
    )


def inputs_cases() -> dict[str, TestCase]:
    """Return flights that together use every kind of input, most modes, gusts, and each family of sensor faults."""
    return {
        "inputs-gps-and-barometer": inputs_case(
            StartState(mode="LOITER", altitude_m=30.0),
            40.0,
            (
                (2.0, "sensor_fault", "gps_noise", (2.0,)),
                (6.0, "sensor_fault", "SIM_GPS_GLITCH_X", (8.0,)),
                (10.0, "sensor_fault", "baro_drift", (0.4,)),
                (14.0, "stick", "RC2", (1300.0,)),
                (18.0, "stick", "RC2", (1500.0,)),
                (20.0, "sensor_fault", "SIM_BARO_RND", (0.5,)),
                (24.0, "mode", "ALT_HOLD", ()),
                (28.0, "sensor_fault", "gps_loss", (1.0,)),
            ),
        ),
        "inputs-inertial-and-compass": inputs_case(
            StartState(mode="ALT_HOLD", altitude_m=60.0),
            36.0,
            (
                (1.0, "sensor_fault", "SIM_GYR_BIAS_X", (0.03,)),
                (3.0, "sensor_fault", "SIM_GYR_RND", (3.0,)),
                (6.0, "sensor_fault", "SIM_ACC_BIAS_Y", (0.4,)),
                (9.0, "sensor_fault", "SIM_ACC_RND", (0.8,)),
                (12.0, "sensor_fault", "compass_noise", (0.05,)),
                (15.0, "sensor_fault", "SIM_MAG_OFFSET_X", (90.0,)),
                (18.0, "stick", "RC1", (1650.0,)),
                (20.0, "stick", "RC4", (1600.0,)),
                (24.0, "mode", "STABILIZE", ()),
                (26.0, "stick", "RC3", (1600.0,)),
                (28.0, "mode", "ACRO", ()),
            ),
        ),
        "inputs-battery-and-engine": inputs_case(
            StartState(mode="GUIDED", altitude_m=40.0),
            45.0,
            (
                (1.0, "command", "MAV_CMD_DO_REPOSITION", (0.0, 0.0, 0.0, 0.0, 47.3984, 8.5461, 35.0)),
                (3.0, "parameter", "BATT_LOW_VOLT", (14.0,)),
                (5.0, "sensor_fault", "battery_voltage", (13.0,)),
                (30.0, "sensor_fault", "SIM_ENGINE_MUL", (0.6,)),
                (32.0, "sensor_fault", "engine_failure", (2.0,)),
            ),
            parameters={"BATT_LOW_TIMER": 3.0},
        ),
        "inputs-wind-and-gusts": inputs_case(
            StartState(mode="CIRCLE", altitude_m=25.0),
            44.0,
            (
                (4.0, "stick", "RC2", (1300.0,)),
                (8.0, "parameter", "CIRCLE_RATE", (-30.0,)),
                (14.0, "mode", "BRAKE", ()),
                (18.0, "command", "MAV_CMD_CONDITION_YAW", (120.0, 30.0, 1.0, 0.0)),
                (20.0, "sensor_fault", "wind", (9.0,)),
                (24.0, "mode", "RTL", ()),
                (34.0, "mode", "LAND", ()),
            ),
            wind=Wind(mean_mps=5.0, from_deg=250.0, gust_mps=1.5, gust_period_s=4.0),
        ),
        "inputs-from-the-ground": inputs_case(
            StartState(mode="GUIDED", altitude_m=0.0),
            50.0,
            (
                (1.0, "command", "MAV_CMD_NAV_TAKEOFF", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 18.0)),
                (10.0, "parameter", "WPNAV_SPEED", (300.0,)),
                (11.0, "command", "MAV_CMD_DO_REPOSITION", (0.0, 0.0, 0.0, 0.0, 47.3979, 8.5456, 22.0)),
                (14.0, "command", "MAV_CMD_CONDITION_YAW", (120.0, 30.0, 1.0, 0.0)),
                (18.0, "mode", "ALT_HOLD", ()),
                (19.0, "mode", "FLIP", ()),
                (24.0, "mode", "LOITER", ()),
                (26.0, "stick", "RC1", (1700.0,)),
                (29.0, "sensor_fault", "radio_loss", (1.0,)),
            ),
            wind=Wind(mean_mps=2.0, from_deg=30.0),
        ),
    }
