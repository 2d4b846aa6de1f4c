"""A point mass on a line, held at a place by a controller: the smallest target whose flights repeat bit by bit.

One fault is planted, which the policy beside this file forbids: a gain above 8 while over half of the damping is lost.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from saflite.contract.described import check_described
from saflite.contract.errors import Unavailable
from saflite.contract.flight import Delivered, FlightRecord, Trace
from saflite.contract.ids import digest
from saflite.contract.service import Cancelled
from saflite.contract.target import Slot
from saflite.contract.target_info import InputInfo, SignalInfo, TargetInfo
from saflite.contract.test_case import StartState, TestCase

STEP_S, EDGE_M = 0.02, 100.0
UNITS = {"place_m": "m", "speed_mps": "m/s", "aim_m": "m", "gain": "1/s^2"}
INPUTS = (
    InputInfo(kind="parameter", name="AIM", unit="m", low=-10, high=10, default=0, meaning="place to keep"),
    InputInfo(kind="parameter", name="GAIN", unit="1/s^2", low=0.5, high=12, default=2, meaning="stiffness"),
    InputInfo(kind="sensor_fault", name="WEAK", low=0, high=1, default=0, meaning="share of damping lost"),
)


def describe() -> TargetInfo:
    """Say what it is."""
    return TargetInfo(
        name="point_mass",
        build=digest(Path(__file__).read_bytes()),
        repeats="bitwise",
        inputs=INPUTS,
        signals=tuple(UNITS),
        own_signals={name: SignalInfo(unit=unit) for name, unit in UNITS.items()},
        start_states=(StartState(mode="KEEP", altitude_m=0.0),),
        time_limit_max_s=600.0,
    )


def check(test_case: TestCase) -> None:
    """Raise Refused for what `describe` does not name."""
    check_described(describe(), test_case)


def open(slot: Slot) -> Session:  # noqa: A001
    """Return a session; nothing needs to be brought up."""
    return Session()


class Session:
    """Flies, and holds nothing."""

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Step the mass through the test case."""
        values = {one.name: one.default or 0.0 for one in INPUTS} | test_case.target.parameters
        ranges = {one.name: (one.low or 0.0, one.high or 0.0) for one in INPUTS}
        due = sorted(enumerate(test_case.stimuli), key=lambda pair: pair[1].at_s)
        rows, given, place_m, speed_mps = [], [], 0.0, 0.0
        for number in range(round(test_case.scenario.time_limit_s / STEP_S)):
            if cancelled():
                raise Unavailable("flight cancelled")
            while due and due[0][1].at_s <= number * STEP_S + 1e-9:
                index, one = due.pop(0)
                taken = ranges[one.name][0] <= one.values[0] <= ranges[one.name][1]
                values[one.name] = one.values[0] if taken else values[one.name]
                given.append(Delivered(index=index, at_s=number * STEP_S, answer="accepted" if taken else "denied"))
            rows.append((place_m, speed_mps, values["AIM"], values["GAIN"]))
            damping = -1.0 if values["GAIN"] > 8.0 and values["WEAK"] > 0.5 else 2.0 - values["WEAK"]
            speed_mps += STEP_S * (values["GAIN"] * (values["AIM"] - place_m) - damping * speed_mps)
            place_m = min(EDGE_M, max(-EDGE_M, place_m + STEP_S * speed_mps))
        columns = zip(UNITS, np.array(rows, "<f4").T, strict=True)
        trace = Trace(step_s=STEP_S, signals={name: column.tobytes() for name, column in columns})
        return FlightRecord("completed", trace, delivered=tuple(given))

    def close(self) -> None:
        """Nothing to end."""
