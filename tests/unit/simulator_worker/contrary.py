"""A target whose flights contradict what it says of itself, in the way its parameter `WRONG` picks."""

from __future__ import annotations

from itertools import count
from typing import Any, cast

import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, FlightRecord, Trace
from saflite.contract.service import Cancelled
from saflite.contract.target import Slot
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import StartState, TestCase

RIGHT, SIGNAL, SAMPLES, ENDING, INDEX, REPEAT, EARLY, NO_TRACE, NEW_SIGNAL, FILE_NAME, MESSAGE, LIMIT, ENDLESS = range(
    13
)
BUILD = "b" * 64


def describe() -> TargetInfo:
    return TargetInfo(
        name="contrary",
        build=BUILD,
        repeats="bitwise",
        inputs=(InputInfo(kind="parameter", name="WRONG", low=0, high=12),),
        signals=("altitude_m", "x_m"),
        start_states=(StartState(),),
    )


def check(test_case: TestCase) -> None:
    if test_case.target.parameters.get("REFUSED"):
        raise Refused("test case", expected="another", got="this one")


def open(slot: Slot) -> Contrary:  # noqa: A001
    (slot.folder / "left behind").write_text("by a session")
    return Contrary(slot)


class Contrary:
    def __init__(self, slot: Slot) -> None:
        self._slot, self._numbers = slot, count()

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        wrong = int(test_case.target.parameters.get("WRONG", RIGHT))
        limit_s = test_case.scenario.time_limit_s
        samples = 10 if wrong == ENDLESS else min(10, round(limit_s / 0.1))
        height = {REPEAT: float(next(self._numbers)), LIMIT: limit_s}.get(wrong, 1.0)
        altitude = np.full(samples, height, "<f4").tobytes()
        signals = {"altitude_m": altitude, "x_m": altitude[4:] if wrong == SAMPLES else altitude}
        if wrong == SIGNAL:
            del signals["x_m"]
        if wrong == NEW_SIGNAL:
            signals["y_m"] = altitude
        given = [Delivered(index=place, at_s=one.at_s) for place, one in enumerate(test_case.stimuli)]
        if wrong == INDEX:
            given.append(Delivered(index=len(given), at_s=1.0))
        if wrong == EARLY:
            given = [Delivered(index=one.index, at_s=one.at_s - 0.5) for one in given]
        ending = cast(Any, "exploded" if wrong == ENDING else "completed")
        trace = None if wrong == NO_TRACE else Trace(step_s=0.1, signals=signals)
        files = (("../console.txt" if wrong == FILE_NAME else "console.txt", f"slot {self._slot.index}".encode()),)
        return FlightRecord(ending, trace, cast(Any, None if wrong == MESSAGE else ""), tuple(given), files)

    def close(self) -> None:
        """Nothing is held."""
