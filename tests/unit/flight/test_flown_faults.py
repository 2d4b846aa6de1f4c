"""Faults of the reference that outsiders found by flying: lift-offs, tumbles and missions that order odd speeds."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Trace
from saflite.contract.test_case import MissionItem, Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
from saflite.flight.mission import builtin_mission

Input = tuple[float, StimulusKind, str, tuple[float, ...]]


def flown(test_case: TestCase) -> Trace:
    record = fly_once(test_case)
    assert record.trace is not None
    return record.trace


def fly(mode: str, altitude_m: float, time_s: float, *inputs: Input, **parameters: float) -> Trace:
    stimuli = tuple(Stimulus(at_s=at, kind=kind, name=name, values=values) for at, kind, name, values in inputs)
    start = StartState(mode=mode, altitude_m=altitude_m)
    target = Target(parameters=parameters)
    return flown(TestCase(target=target, scenario=Scenario(start=start, time_limit_s=time_s), stimuli=stimuli))


@pytest.mark.parametrize(("set_cm", "most_m"), [(0.0, 4.0), (300.0, 6.0)])
def test_a_pilots_take_off_counts_from_where_it_stands(set_cm: float, most_m: float) -> None:
    """The barometer thinks it stands 15 m below home: it does not climb there by itself."""
    glitch: Input = (1.0, "sensor_fault", "SIM_BARO_GLITCH", (-15.0,))
    up: Input = (8.0, "stick", "RC3", (1650.0,))
    centred: Input = (9.5, "stick", "RC3", (1500.0,))
    altitude_m = fly("ALT_HOLD", 0.0, 30.0, glitch, up, centred, PILOT_TKOFF_ALT=set_cm).array("altitude_m")
    assert 0.5 * set_cm / 100.0 <= altitude_m.max() < most_m


@pytest.mark.parametrize("motor", [1.0, 2.0, 3.0])
def test_a_parachute_opens_in_a_tumble(motor: float) -> None:
    """A vehicle that tumbles is upright, and leans by roll and pitch alone by little, again and again."""
    weak: Input = (2.9, "sensor_fault", "SIM_ENGINE_MUL", (0.0,))
    trace = fly("LOITER", 100.0, 20.0, weak, (3.0, "sensor_fault", "SIM_ENGINE_FAIL", (motor,)), CHUTE_ENABLED=1.0)
    assert trace.array("chute_released").max() == 1.0


@pytest.mark.parametrize("name", ["SIM_GPS_GLITCH_X", "SIM_GPS_GLITCH_Y"])
def test_a_mission_lifts_off_straight_up_whatever_its_estimate_did_before(name: str) -> None:
    glitch = Stimulus(at_s=4.0, kind="sensor_fault", name=name, values=(20.0,))
    scenario = Scenario(mission=builtin_mission("mission2"), time_limit_s=24.0)
    trace = flown(TestCase(target=Target(), scenario=scenario, stimuli=(glitch,)))
    low = trace.array("altitude_m") < 4.0
    assert np.hypot(trace.array("x_m"), trace.array("y_m"))[low].max() < 0.5
    assert trace.array("altitude_m").max() > 4.0


@pytest.mark.parametrize("speed_mps", [-1.0, 0.0, 0.05])
def test_a_mission_flies_on_where_it_orders_a_speed_that_cannot_be_flown(speed_mps: float) -> None:
    """MAVLink's -1 means no change, ArduCopter takes nothing below 0.2 m/s: it flew backwards or hardly."""
    usual = builtin_mission("mission2")
    first = next(place for place, item in enumerate(usual.items) if item.command == 22)
    order = MissionItem(command=178, params=(1.0, speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0))
    items = (*usual.items[: first + 1], order, *usual.items[first + 1 :])
    scenario = Scenario(mission=msgspec.structs.replace(usual, items=items), time_limit_s=200.0)
    slow = flown(TestCase(target=Target(), scenario=scenario))
    plain = flown(TestCase(target=Target(), scenario=msgspec.structs.replace(scenario, mission=usual)))
    assert slow.duration_s == pytest.approx(plain.duration_s, abs=1.0)


def test_a_mission_start_that_is_refused_does_not_wind_the_mission_back() -> None:
    """Without a position AUTO is refused; who goes on with the mission later goes on where it was left."""
    left: Input = (50.0, "mode", "ALT_HOLD", ())
    lost: Input = (52.0, "sensor_fault", "SIM_GPS_DISABLE", (1.0,))
    refused: Input = (60.0, "command", "MAV_CMD_MISSION_START", (0.0,) * 7)
    found: Input = (62.0, "sensor_fault", "SIM_GPS_DISABLE", (0.0,))
    back: Input = (75.0, "mode", "AUTO", ())
    stimuli = tuple(
        Stimulus(at_s=at, kind=kind, name=name, values=values)
        for at, kind, name, values in (left, lost, refused, found, back)
    )
    scenario = Scenario(mission=builtin_mission("mission2"), time_limit_s=80.0)
    record = fly_once(TestCase(target=Target(), scenario=scenario, stimuli=stimuli))
    assert record.trace is not None
    assert record.delivered is not None
    assert [order.answer for order in record.delivered][2:] == ["denied", "accepted", "accepted"]
    item, step_s = record.trace.array("mission_item"), record.trace.step_s
    assert item[int(61.0 / step_s) :].min() == item[: int(49.0 / step_s)].max() > 0


def test_no_take_off_without_a_position() -> None:
    """Its failsafe was raised on the ground, where it does nothing: it would not come again in the air."""
    lost: Input = (1.0, "sensor_fault", "SIM_GPS_DISABLE", (1.0,))
    up: Input = (10.0, "command", "MAV_CMD_NAV_TAKEOFF", (0.0,) * 6 + (10.0,))
    trace = fly("GUIDED", 0.0, 20.0, lost, up, DISARM_DELAY=0.0)
    assert trace.array("armed").max() == 1.0
    assert trace.array("altitude_m").max() < 0.5
