"""Signals the oracle makes itself: from the test case, the ending, and the rest of the trace."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.flight import Ending, Flight, Trace, TraceMessage
from saflite.contract.test_case import Scenario, Stimulus, StimulusKind, Target, TestCase
from saflite.oracle.log_text import describe, facts_of, rule_of_thumb
from saflite.oracle.signals import FlightSignals, fault_of, stops_motors

STEP_S = 0.5


def signals(*stimuli: Stimulus, ending: Ending = "completed", **written: list[float]) -> FlightSignals:
    columns = {name: np.asarray(values, dtype="<f4").tobytes() for name, values in written.items()}
    case = TestCase(target=Target(), scenario=Scenario(), stimuli=stimuli)
    flight = Flight(test_case="", flight_index=0, ending=ending)
    return FlightSignals(case, flight, Trace(step_s=STEP_S, signals=columns))


def stimulus(kind: StimulusKind, name: str, *values: float, at_s: float = 1.0) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)


@pytest.mark.parametrize(
    ("kind", "name", "flag"),
    [
        ("sensor_fault", "SIM_GPS_NOISE", "gps_true"),
        ("sensor_fault", "gps_loss", "gps_true"),
        ("parameter", "SIM_GPS_GLITCH_X", "gps_true"),
        ("sensor_fault", "SIM_BARO_DRIFT", "baro_true"),
        ("sensor_fault", "baro_offset", "baro_true"),
        ("sensor_fault", "SIM_ENGINE_FAIL", "body_true"),
        ("sensor_fault", "SIM_WIND_SPD", "body_true"),
        ("sensor_fault", "SIM_RC_FAIL", ""),
        ("sensor_fault", "radio_loss", ""),
        ("sensor_fault", "SIM_BATT_VOLTAGE", ""),
        ("parameter", "RC3_MIN", "sticks_true"),
        ("parameter", "RTL_ALT", ""),
        ("stick", "RC3", ""),
        ("mode", "LOITER", ""),
    ],
)
def test_which_faults_excuse_what(kind: StimulusKind, name: str, flag: str) -> None:
    assert fault_of(stimulus(kind, name, 1.0)) == flag


@pytest.mark.parametrize(
    ("name", "values", "stops"),
    [
        ("MAV_CMD_DO_FLIGHTTERMINATION", (1.0,), True),
        ("MAV_CMD_DO_FLIGHTTERMINATION", (0.0,), False),
        ("MAV_CMD_COMPONENT_ARM_DISARM", (0.0, 21196.0), True),
        ("MAV_CMD_COMPONENT_ARM_DISARM", (0.0, 0.0), False),
        ("MAV_CMD_COMPONENT_ARM_DISARM", (1.0, 21196.0), False),
        ("MAV_CMD_NAV_LAND", (), False),
    ],
)
def test_only_forced_stops_excuse_motors_off(name: str, values: tuple[float, ...], stops: bool) -> None:
    assert stops_motors(stimulus("command", name, *values)) is stops


def test_quiet_times_and_flags_follow_the_stimuli() -> None:
    given = signals(
        stimulus("parameter", "RTL_ALT", 1.0, at_s=0.5),
        stimulus("mode", "RTL", at_s=1.0),
        stimulus("sensor_fault", "SIM_BARO_RND", 1.0, at_s=1.5),
        x_m=[0.0] * 6,
    )
    assert given["time_s"].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    assert given["quiet_s"].tolist() == [0.0, 0.0, 0.0, 0.0, 0.5, 1.0]
    assert given["order_quiet_s"].tolist() == [0.0, 0.5, 0.0, 0.5, 1.0, 1.5]
    assert given["baro_true"].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    assert given["gps_true"].min() == 1.0


def test_only_a_crash_raises_crashed() -> None:
    assert signals(ending="crashed", x_m=[0.0] * 3)["crashed"].tolist() == [0.0, 0.0, 1.0]
    assert signals(ending="timed_out", x_m=[0.0] * 3)["crashed"].tolist() == [0.0, 0.0, 0.0]


def test_made_signals_need_their_sources() -> None:
    given = signals(vx_mps=[3.0], vy_mps=[4.0], roll_deg=[60.0], altitude_m=[7.0])
    assert given["ground_speed_mps"].tolist() == [5.0]
    assert given["altitude_est_m"].tolist() == [7.0]
    assert "tilt_deg" not in given
    assert "home_distance_m" not in given
    assert set(given.pick(frozenset({"tilt_deg", "ground_speed_mps"}))) == {"ground_speed_mps"}


def test_a_log_is_told_as_text_and_as_facts() -> None:
    samples = 100
    columns = {
        "altitude_m": np.linspace(0, 20, samples),
        "mode": [4.0] * 50 + [9.0] * 50,
        "climb_mps": [-6.0] * samples,
    }
    trace = Trace(
        step_s=0.1,
        signals={name: np.asarray(values, dtype="<f4").tobytes() for name, values in columns.items()},
        messages=(TraceMessage(at_s=5.0, text="EKF failsafe: position lost", severity="error"),),
    )
    text, facts = describe(trace), facts_of(trace)
    for part in ("Duration 9.9 s", "0.0 s GUIDED", "5.0 s LAND", "error: EKF failsafe", "0.00, 10.00, 20.00 m"):
        assert part in text
    assert (facts.errors, facts.failsafes, facts.mode_changes, facts.sink_max_mps) == (1, 1, 1, 6.0)
    assert tuple(rule_of_thumb(facts)) == (pytest.approx(2.5 + 2.5 + 1.5), "1 errors, 1 failsafes, sinks 6.0 m/s")
    quiet = Trace(step_s=0.1, signals={"altitude_m": np.zeros(50, dtype="<f4").tobytes()})
    assert rule_of_thumb(facts_of(quiet)) == (0.0, "nothing out of the ordinary")


@pytest.mark.parametrize(("distance_m", "told", "score"), [(1.2, True, 6.0), (3.0, True, 0.0), (1000.0, False, 0.0)])
def test_a_near_miss_is_told_and_counts(distance_m: float, told: bool, score: float) -> None:
    columns = {"x_m": [0.0, 1.0, 2.0], "obstacle_distance_m": [1000.0, distance_m, 1000.0]}
    packed = {name: np.asarray(values, dtype="<f4").tobytes() for name, values in columns.items()}
    trace = Trace(step_s=0.1, signals=packed)
    assert ("competition distance" in describe(trace)) == told
    assert rule_of_thumb(facts_of(trace)).score == score
