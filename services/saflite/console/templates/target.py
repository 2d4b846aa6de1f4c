"""A mass on a spring that is to keep its place: a target to begin with. Put your vehicle in the place of `_step`.

saflite conformance target NAME --module NAME.py
saflite run NAME-campaign.toml --module NAME.py
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

STEP_S = 0.02
SIGNALS = {"place_m": "m", "speed_mps": "m/s"}
INPUTS = (
    InputInfo(kind="parameter", name="AIM", unit="m", low=-10, high=10, default=0, meaning="place to keep"),
    InputInfo(kind="parameter", name="GAIN", unit="1/s^2", low=0.5, high=12, default=2, meaning="stiffness"),
    InputInfo(kind="parameter", name="DAMPING", unit="1/s", low=-1, high=4, default=2, meaning="damping"),
)


def describe() -> TargetInfo:
    """Say what it is: inputs, signals, and a digest of all that shapes a flight (here this file; add your binary)."""
    return TargetInfo(
        name=Path(__file__).stem,
        build=digest(Path(__file__).read_bytes()),
        repeats="bitwise",  # "statistically" where the same test case may fly differently
        inputs=INPUTS,
        signals=tuple(SIGNALS),
        own_signals={name: SignalInfo(unit=unit) for name, unit in SIGNALS.items()},
        start_states=(StartState(mode="KEEP", altitude_m=0.0),),
        time_limit_max_s=600.0,
    )


def check(test_case: TestCase) -> None:
    """Raise Refused for what `describe` does not name."""
    check_described(describe(), test_case)


def open(slot: Slot) -> Session:  # noqa: A001
    """Return a session: start your simulator here, in the folder and on the ports of the slot."""
    return Session()


class Session:
    """Flies one test case after another."""

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly it from the start: give each input at its time, note each signal at every step."""
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
            rows.append((place_m, speed_mps))
            place_m, speed_mps = _step(place_m, speed_mps, values)
        columns = zip(SIGNALS, np.array(rows, "<f4").T, strict=True)
        trace = Trace(step_s=STEP_S, signals={name: column.tobytes() for name, column in columns})
        return FlightRecord("completed", trace, delivered=tuple(given))

    def close(self) -> None:
        """End the simulator."""


def _step(place_m: float, speed_mps: float, values: dict[str, float]) -> tuple[float, float]:
    """Return place and speed a step later; the place ends at 100 m."""
    speed_mps += STEP_S * (values["GAIN"] * (values["AIM"] - place_m) - values["DAMPING"] * speed_mps)
    return min(100.0, max(-100.0, place_m + STEP_S * speed_mps)), speed_mps
