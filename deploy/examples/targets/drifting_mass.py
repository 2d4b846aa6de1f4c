"""A mass in a wind that is never the same twice: the smallest target whose outcomes repeat only statistically.

The wind comes from the operating system's entropy, so no seed repeats a flight. Told to lean 14 m or more (`LEAN`), the
mass always leaves its corridor of 10 m, below 6 m never, and between them by chance: a finding is a matter of k of n.
"""

from __future__ import annotations

import os
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

STEP_S, GUST_M = 0.1, 4.0
LEAN = InputInfo(kind="parameter", name="LEAN", unit="m", low=0, high=20, default=0, meaning="how far it leans")


def describe() -> TargetInfo:
    """Say what it is."""
    return TargetInfo(
        name="drifting_mass",
        build=digest(Path(__file__).read_bytes()),
        repeats="statistically",
        inputs=(LEAN,),
        signals=("offset_m",),
        own_signals={"offset_m": SignalInfo(unit="m", meaning="distance from the middle of the corridor")},
        start_states=(StartState(mode="DRIFT_ALONG", altitude_m=0.0),),
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
        """Lean as told, and be pushed by one gust drawn for the whole flight."""
        if cancelled():
            raise Unavailable("flight cancelled")
        gust_m = GUST_M * (2.0 * int.from_bytes(os.urandom(4), "little") / 2**32 - 1.0)
        times = np.arange(round(test_case.scenario.time_limit_s / STEP_S)) * STEP_S
        lean_m = np.full(len(times), test_case.target.parameters.get("LEAN", 0.0))
        given = []
        for index, one in sorted(enumerate(test_case.stimuli), key=lambda pair: pair[1].at_s):
            taken = 0.0 <= one.values[0] <= 20.0
            if taken:
                lean_m[times >= one.at_s - 1e-9] = one.values[0]
            given.append(Delivered(index=index, at_s=one.at_s, answer="accepted" if taken else "denied"))
        offset_m = (lean_m + gust_m * np.minimum(1.0, times / 5.0)).astype("<f4")
        in_time = tuple(one for one in given if one.at_s <= times[-1])
        return FlightRecord(
            "completed", Trace(step_s=STEP_S, signals={"offset_m": offset_m.tobytes()}), delivered=in_time
        )

    def close(self) -> None:
        """Nothing to end."""
