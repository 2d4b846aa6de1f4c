"""Faults of the reference that an outsider found by flying: where it lifts off to, and whether a tumble is seen."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Trace
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
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
