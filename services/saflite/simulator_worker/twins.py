"""A second flight that must go as the first: which one it is, and how far from the first it went.

Some faults show in no flight alone, since nobody can say what the right flight would be. But turned by a right angle,
mirrored, by another radio, without what does nothing in it, or without what came before it must be the same
(metamorphic testing, Chen et al. 1998; Segura et al. 2016).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, FlightRecord, Trace
from saflite.contract.target_info import COMPARED, TargetInfo
from saflite.contract.test_case import TestCase, Twin
from saflite.flight.isometry import TURN_DEG, mirrored, turned
from saflite.simulator_worker.afresh import Second, afresh
from saflite.simulator_worker.recalibrated import recalibrated

_Values = NDArray[np.floating]
CODES = {"turned": 1.0, "idle": 2.0, "afresh": 3.0, "mirrored": 4.0, "recalibrated": 5.0}


NOTHING_TO_CHANGE: dict[Twin, str] = {
    "idle": "nothing was refused that could be left out",
    "afresh": "it is not called back to a place to rest there, or nothing came before that could be left out",
    "recalibrated": "no stick can be shifted within its calibrations",
}


def check_twin(info: TargetInfo, test_case: TestCase) -> None:
    """Raise Refused where the target cannot fly the twin of a test case, or begin with its heading."""
    if test_case.heading_deg and not info.turns:
        raise Refused("heading_deg", expected=f"0: target {info.name} takes none", got=test_case.heading_deg)
    if test_case.twin and not info.flies_twin(test_case.twin):
        why = (
            f"one that repeats bit by bit, writes {', '.join(COMPARED)} and, to be turned or mirrored, takes a heading"
        )
        raise Refused(f"twin {test_case.twin!r}", expected=why, got=f"target {info.name}")


def with_twin(
    info: TargetInfo, test_case: TestCase, record: FlightRecord, fly: Callable[[TestCase], FlightRecord]
) -> FlightRecord:
    """Return the record of a flight, with how far its twin is apart in its trace where the test case asks for one.

    Without a trace of both, or where there is nothing to leave out, the record stays as it is.
    """
    if not test_case.twin or record.trace is None:
        return record
    second = _second(info, test_case, _denied(record.delivered))
    if second is None:
        return record
    flown = fly(second.test_case)
    if second.orders & _denied(flown.delivered):
        return record
    if flown.trace is None or flown.trace.step_s != record.trace.step_s:
        return record
    signals = {**record.trace.signals, **_apart(test_case, record.trace, flown.trace, second.from_s)}
    return record._replace(trace=msgspec.structs.replace(record.trace, signals=signals))


def why_alone(info: TargetInfo, test_case: TestCase, delivered: Iterable[Delivered] | None, trace: Trace | None) -> str:
    """Return in words why a flight that asks for a twin was compared with none; empty if it was, or asks for none."""
    if not test_case.twin or (trace is not None and "twin" in trace.signals):
        return ""
    if trace is not None and _second(info, test_case, _denied(delivered)) is None:
        return f"no second flight was flown: {NOTHING_TO_CHANGE[test_case.twin]}"
    return "it was compared with no second flight: one of the two left nothing to compare"


def _denied(delivered: Iterable[Delivered] | None) -> set[int]:
    """Return which inputs were refused, by their place."""
    return {one.index for one in delivered or () if one.answer == "denied"}


def _second(info: TargetInfo, test_case: TestCase, denied: set[int]) -> Second | None:
    plain = msgspec.structs.replace(test_case, twin="")
    rest = {entry.name: entry.default for entry in info.inputs if entry.default is not None}
    if test_case.twin == "turned":
        return Second(turned(plain, rest))
    if test_case.twin == "mirrored":
        return Second(mirrored(plain, rest))
    if test_case.twin == "recalibrated":
        second = recalibrated(plain, info.inputs, denied)
        return None if second is None else Second(second)
    if test_case.twin == "afresh":
        return afresh(plain, rest, denied)
    return _idle(plain, denied, {entry.name for entry in info.inputs if entry.kind == "parameter" and entry.restart})


def _idle(test_case: TestCase, denied: set[int], waiting: set[str]) -> Second | None:
    """Return the flight without what does nothing in it: refused, or a setting that acts at the next start."""
    kept = tuple(
        one
        for index, one in enumerate(test_case.stimuli)
        if index not in denied and not (one.kind == "parameter" and one.name in waiting)
    )
    return Second(msgspec.structs.replace(test_case, stimuli=kept)) if len(kept) < len(test_case.stimuli) else None


def _apart(test_case: TestCase, first: Trace, second: Trace, from_s: float) -> dict[str, bytes]:
    """Return the signals `twin_*`; 0 where only one of the two flies still, or need not go alike yet."""
    both = min(first.samples, second.samples)
    one, two = ({name: trace.array(name)[:both] for name in COMPARED} for trace in (first, second))
    north, east, yaw_deg = _back(test_case.twin, two["x_m"], two["y_m"], two["yaw_deg"])
    found: dict[str, _Values] = {
        "twin": np.full(both, CODES[test_case.twin]),
        "twin_x_apart_m": north - one["x_m"],
        "twin_y_apart_m": east - one["y_m"],
        "twin_height_apart_m": two["altitude_m"] - one["altitude_m"],
        "twin_heading_apart_deg": (yaw_deg - one["yaw_deg"] + 180.0) % 360.0 - 180.0,
        "twin_mode_apart": two["mode"] != one["mode"],
        "twin_armed_apart": two["armed"] != one["armed"],
    }
    rest, early = np.zeros(first.samples - both, dtype=np.float32), np.arange(both) * first.step_s < from_s
    told = {name: np.where(early, 0.0, values) for name, values in found.items()}
    return {name: np.concatenate([values, rest]).astype("<f4").tobytes() for name, values in told.items()}


def _back(twin: Twin, x_m: _Values, y_m: _Values, yaw_deg: _Values) -> tuple[_Values, _Values, _Values]:
    """Return where the second flight is and looks, turned or mirrored back."""
    if twin == "turned":
        return y_m, -x_m, yaw_deg - TURN_DEG
    return (x_m, -y_m, -yaw_deg) if twin == "mirrored" else (x_m, y_m, yaw_deg)
