"""The same flight by another radio: its pulses and their spans are others, and the autopilot is calibrated for them."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

from msgspec.structs import replace

from saflite.contract.target_info import InputInfo
from saflite.contract.test_case import Stimulus, TestCase

SHIFTS_US = {"RC1": 40.0, "RC2": -30.0, "RC3": 25.0, "RC4": -45.0}
"""Whole numbers, as calibrations are, and no two of a size: a shift changes neither dead zones nor spans."""
SHARE = 0.5
"""Of the span, dead zones with it. Halves keep shares of a stick's way to the last bit; twice as much does not fit."""

_THROTTLE, _LOST, _FLIP_US = "RC3", "FS_THR_VALUE", 1500.0
_RADIO_FAILS = "RC_FAIL"
_CENTRE_US = 1500.0
_PLACES, _WIDTHS = ("MIN", "MAX", "TRIM"), ("DZ",)
_THROTTLE_WIDTH = "THR_DZ"


class Change(NamedTuple):
    """What another radio makes of a pulse: `share` of its way from the middle, then a shift."""

    share: float
    shift_us: float

    def pulse(self, value_us: float) -> float:
        """Return a pulse, or a place on the way of a stick, as the other radio has it."""
        return _CENTRE_US + self.share * (value_us - _CENTRE_US) + self.shift_us

    def of(self, name: str, value_us: float) -> float:
        """Return what a stick or one of its calibrations is given."""
        return self.share * value_us if name.endswith(_WIDTHS) else self.pulse(value_us)


def recalibrated(test_case: TestCase, inputs: Sequence[InputInfo], denied: Container[int] = ()) -> TestCase | None:
    """Return the test case with other pulses of each stick, and calibrations that fit (`RCn_MIN`, `_DZ`, ...).

    A stick has half its span and a shift, or a shift alone where halves do not fit; it stays as it is where no shift
    keeps all its calibrations within their range (`inputs`) and whole. So does the throttle where it is not in the
    middle as the flight begins, or where a pulse would pass one that means something by itself: a lost radio
    (`FS_THR_VALUE`), the least at which FLIP begins, or where that of a lost radio lies within its way.
    What was refused (`denied`, by place) is left as it is. None where nothing can be changed.
    """
    known = {entry.name: entry for entry in inputs}
    taken = [one for index, one in enumerate(test_case.stimuli) if index not in denied]
    changes: dict[str, Change] = {}
    for stick, shift_us in SHIFTS_US.items():
        tried = (Change(share, way * shift_us) for share in (SHARE, 1.0) for way in (1.0, -1.0))
        fitting = next((one for one in tried if _fits(test_case, taken, known, stick, one)), None)
        if fitting is not None:
            changes[stick] = fitting
    if not changes:
        return None
    begin = tuple(chain.from_iterable(_beginning(test_case, known, stick, one) for stick, one in changes.items()))
    calibrated = {name for stick in changes for name in _calibrations(stick, known)}
    kept = {name: value for name, value in test_case.target.parameters.items() if name not in calibrated}
    by_name = {name: one for stick, one in changes.items() for name in (stick, *_calibrations(stick, known))}
    after = (one if index in denied else _changed(one, by_name) for index, one in enumerate(test_case.stimuli))
    return replace(test_case, target=replace(test_case.target, parameters=kept), stimuli=(*begin, *after))


def _calibrations(stick: str, known: Mapping[str, InputInfo]) -> list[str]:
    widths = [_THROTTLE_WIDTH] if stick == _THROTTLE else []
    return [name for name in (*(f"{stick}_{what}" for what in (*_PLACES, *_WIDTHS)), *widths) if name in known]


def _at_start(test_case: TestCase, entry: InputInfo) -> float | None:
    return test_case.target.parameters.get(entry.name, entry.default)


def _fits(
    test_case: TestCase, taken: Iterable[Stimulus], known: Mapping[str, InputInfo], stick: str, change: Change
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
        for value in (first, *given[name]):
            made = change.of(name, value)
            if not entry.low <= made <= entry.high or (made != int(made) and change.share != 1.0):
                return False
    return bool(names) and (stick != _THROTTLE or _throttle_fits(test_case, given, known, change))


def _throttle_fits(
    test_case: TestCase, given: Mapping[str, Sequence[float]], known: Mapping[str, InputInfo], change: Change
) -> bool:
    start = test_case.scenario.start
    if start is not None and start.altitude_m <= 0.0:
        return False
    if any(_RADIO_FAILS in one.name for one in test_case.stimuli) and not _above_lost(test_case, given, known, change):
        return False
    marks = [*given[_LOST], *([_FLIP_US] if any(one.name == "FLIP" for one in test_case.stimuli) else [])]
    if _LOST in known and (first := _at_start(test_case, known[_LOST])) is not None:
        marks.append(first)
    pulses = (_CENTRE_US, *given[_THROTTLE])
    return all((pulse < mark) == (change.pulse(pulse) < mark) for pulse in pulses for mark in marks)


def _above_lost(
    test_case: TestCase, given: Mapping[str, Sequence[float]], known: Mapping[str, InputInfo], change: Change
) -> bool:
    """Whether the throttle's way begins above any pulse of a lost radio, below which all pulses are the same."""
    lost, end = known.get(_LOST), f"{_THROTTLE}_MIN"
    if lost is None or lost.default is None or end not in known:
        return True
    least = min(one for one in (_at_start(test_case, known[end]), *given[end]) if one is not None)
    return min(least, change.pulse(least)) >= lost.default


def _beginning(test_case: TestCase, known: Mapping[str, InputInfo], stick: str, change: Change) -> Iterable[Stimulus]:
    """Yield what changes calibration and pulse at one moment, as the flight begins."""
    for name in _calibrations(stick, known):
        value = _at_start(test_case, known[name])
        assert value is not None
        yield Stimulus(at_s=0.0, kind="parameter", name=name, values=(change.of(name, value),))
    yield Stimulus(at_s=0.0, kind="stick", name=stick, values=(change.pulse(_CENTRE_US),))


def _changed(one: Stimulus, by_name: Mapping[str, Change]) -> Stimulus:
    if one.name not in by_name or len(one.values) != 1:
        return one
    return replace(one, values=(by_name[one.name].of(one.name, one.values[0]),))
