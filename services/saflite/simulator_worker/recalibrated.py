"""The same flight by another radio: its pulses are longer or shorter, and the autopilot is calibrated for them."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from itertools import chain

from msgspec.structs import replace

from saflite.contract.target_info import InputInfo
from saflite.contract.test_case import Stimulus, TestCase

SHIFTS_US = {"RC1": 40.0, "RC2": -30.0, "RC3": 25.0, "RC4": -45.0}
"""Whole numbers, as calibrations are, and no two of a size: a shift changes neither dead zones nor spans."""

_THROTTLE, _LOST, _FLIP_US = "RC3", "FS_THR_VALUE", 1500.0
_RADIO_FAILS = "RC_FAIL"
_CENTRE_US = 1500.0


def recalibrated(test_case: TestCase, inputs: Sequence[InputInfo], denied: Container[int] = ()) -> TestCase | None:
    """Return the test case with other pulses of each stick, and calibrations that fit (`RCn_MIN`, `_MAX`, `_TRIM`).

    A stick stays as it is where no shift keeps all its calibrations within their range (`inputs`). So does the throttle
    where it is not in the middle as the flight begins, or where a pulse would pass one that means something by itself:
    a lost radio (`FS_THR_VALUE`), the least at which FLIP begins, or where that of a lost radio lies within its way.
    What was refused (`denied`, by place) is left as it is. None where nothing can be shifted.
    """
    known = {entry.name: entry for entry in inputs}
    taken = [one for index, one in enumerate(test_case.stimuli) if index not in denied]
    shifts: dict[str, float] = {}
    for stick, shift_us in SHIFTS_US.items():
        tried = next((one for one in (shift_us, -shift_us) if _fits(test_case, taken, known, stick, one)), 0.0)
        if tried:
            shifts[stick] = tried
    if not shifts:
        return None
    begin = tuple(chain.from_iterable(_beginning(test_case, known, stick, one) for stick, one in shifts.items()))
    calibrated = {name for stick in shifts for name in _calibrations(stick, known)}
    kept = {name: value for name, value in test_case.target.parameters.items() if name not in calibrated}
    after = (one if index in denied else _shifted(one, shifts) for index, one in enumerate(test_case.stimuli))
    return replace(test_case, target=replace(test_case.target, parameters=kept), stimuli=(*begin, *after))


def _calibrations(stick: str, known: Mapping[str, InputInfo]) -> list[str]:
    return [name for what in ("MIN", "MAX", "TRIM") if (name := f"{stick}_{what}") in known]


def _at_start(test_case: TestCase, entry: InputInfo) -> float | None:
    return test_case.target.parameters.get(entry.name, entry.default)


def _fits(
    test_case: TestCase, taken: Iterable[Stimulus], known: Mapping[str, InputInfo], stick: str, shift_us: float
) -> bool:
    names = _calibrations(stick, known)
    given: dict[str, list[float]] = {name: [] for name in (*names, stick, _LOST)}
    for one in taken:
        if one.name in given and len(one.values) == 1:
            given[one.name].append(one.values[0])
    for name in names:
        entry = known[name]
        first = _at_start(test_case, entry)
        if first is None or entry.low is None or entry.high is None:
            return False
        if not all(entry.low <= value + shift_us <= entry.high for value in (first, *given[name])):
            return False
    return bool(names) and (stick != _THROTTLE or _throttle_fits(test_case, given, known, shift_us))


def _throttle_fits(
    test_case: TestCase, given: Mapping[str, Sequence[float]], known: Mapping[str, InputInfo], shift_us: float
) -> bool:
    start = test_case.scenario.start
    if start is not None and start.altitude_m <= 0.0:
        return False
    if any(_RADIO_FAILS in one.name for one in test_case.stimuli) and not _above_lost(
        test_case, given, known, shift_us
    ):
        return False
    marks = [*given[_LOST], *([_FLIP_US] if any(one.name == "FLIP" for one in test_case.stimuli) else [])]
    if _LOST in known and (first := _at_start(test_case, known[_LOST])) is not None:
        marks.append(first)
    pulses = (_CENTRE_US, *given[_THROTTLE])
    return all((pulse < mark) == (pulse + shift_us < mark) for pulse in pulses for mark in marks)


def _above_lost(
    test_case: TestCase, given: Mapping[str, Sequence[float]], known: Mapping[str, InputInfo], shift_us: float
) -> bool:
    """Whether the throttle's way begins above any pulse of a lost radio, below which all pulses are the same."""
    lost, end = known.get(_LOST), f"{_THROTTLE}_MIN"
    if lost is None or lost.default is None or end not in known:
        return True
    least = min(one for one in (_at_start(test_case, known[end]), *given[end]) if one is not None)
    return min(least, least + shift_us) >= lost.default


def _beginning(test_case: TestCase, known: Mapping[str, InputInfo], stick: str, shift_us: float) -> Iterable[Stimulus]:
    """Yield what changes calibration and pulse at one moment, as the flight begins."""
    for name in _calibrations(stick, known):
        value = _at_start(test_case, known[name])
        assert value is not None
        yield Stimulus(at_s=0.0, kind="parameter", name=name, values=(value + shift_us,))
    yield Stimulus(at_s=0.0, kind="stick", name=stick, values=(_CENTRE_US + shift_us,))


def _shifted(one: Stimulus, shifts: Mapping[str, float]) -> Stimulus:
    stick, _, what = one.name.partition("_")
    if stick not in shifts or len(one.values) != 1 or what not in ("", "MIN", "MAX", "TRIM"):
        return one
    return replace(one, values=(one.values[0] + shifts[stick],))
