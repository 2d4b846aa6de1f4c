"""The time a vehicle is given to come to rest: by its speed, its lean and the settings in force."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from saflite.contract.flight import Flight, Trace
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase
from saflite.oracle.signals import FlightSignals


def given(
    speed_mps: float, *stimuli: Stimulus, roll_deg: float = 0.0, seconds: float = 10.0, **parameters: float
) -> FlightSignals:
    written = {"vx_mps": speed_mps, "vy_mps": 0.0, "roll_deg": roll_deg, "pitch_deg": 0.0}
    columns = {name: np.full(round(seconds / 0.5) + 1, value, dtype="<f4").tobytes() for name, value in written.items()}
    case = TestCase(target=Target(parameters=parameters), scenario=Scenario(), stimuli=stimuli)
    flight = Flight(test_case="", flight_index=0, ending="completed")
    return FlightSignals(case, flight, Trace(step_s=0.5, signals=columns))


def stopping_s(speed_mps: float, *stimuli: Stimulus, **rest: Any) -> list[float]:
    return [float(value) for value in given(speed_mps, *stimuli, **rest)["stopping_s"]]


def test_half_of_what_is_set_brakes() -> None:
    assert stopping_s(6.0, WPNAV_ACCEL=300.0)[0] == pytest.approx(4.0)
    assert stopping_s(6.0, WPNAV_ACCEL=100.0)[0] == pytest.approx(12.0)
    assert stopping_s(0.0, WPNAV_ACCEL=100.0, ANGLE_MAX=1000.0)[0] == 0.0, "who stands needs no time"


def test_little_lean_brakes_little_and_a_board_mounted_askew_takes_of_it() -> None:
    lean = stopping_s(6.0, ANGLE_MAX=1000.0)[0]
    assert lean == pytest.approx(6.0 / (0.5 * 9.80665 * np.tan(np.radians(10.0))), rel=1e-4)
    assert stopping_s(6.0, ANGLE_MAX=1000.0, AHRS_TRIM_Y=-0.15)[0] > 5 * lean
    assert stopping_s(6.0, ANGLE_MAX=1000.0, AHRS_TRIM_Y=-0.1745)[0] <= 60.0, "bounded where no lean is left"


def test_settings_count_from_when_they_were_given() -> None:
    held = stopping_s(6.0, Stimulus(at_s=5.0, kind="parameter", name="WPNAV_ACCEL", values=(500.0,)))
    assert [held[0], held[-1]] == pytest.approx([4.0, 2.4])


def test_what_brakes_less_counts_for_a_stop_that_may_be_under_way() -> None:
    held = stopping_s(6.0, Stimulus(at_s=40.0, kind="parameter", name="WPNAV_ACCEL", values=(100.0,)), seconds=50.0)
    assert [held[0], held[-1]] == pytest.approx([4.0, 12.0])
    assert [held[18], held[22]] == pytest.approx([4.0, 12.0]), "from 30 s before it was given"


def test_a_lean_makes_it_faster_first_and_the_way_back_counts() -> None:
    assert stopping_s(6.0, roll_deg=30.0)[0] == pytest.approx(
        (6.0 + 1.25 * 9.80665 * np.tan(np.pi / 6)) / 1.5, rel=1e-4
    )
    assert given(6.0)["settling_s"][0] == pytest.approx(4.0 + 12.0 / 3.0), "12 m beyond, back at 3 m/s"
