"""What a log tells of a flight: the trace, what was changed and ordered in flight, and where each signal comes from."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from saflite.contract.flight import Trace
from saflite.contract.test_case import Stimulus
from saflite.flight.logs.resample import Columns

_OWN_PREFIXES = ("STAT_", "COMPASS_", "CAL_", "INS_", "COM_FLIGHT", "LND_FLIGHT", "MIS_TOTAL", "MOT_THST_HOVER")
_OWN_SUFFIXES = ("_GND_PRESS", "_GNDTEMP", "_ABS_PRESS", "_DEVID", "_DEV_ID")
_LEFT_GROUND_M = 1.0

_DENIED = (
    *("mode_order_s", "ordered_mode", "release_order_s", "stop_order_s"),
    *("plain_order", "plain_order_s", "plain_order_refused"),
)
_STICKS = ("order_quiet_s", "mode_cause_s", "rc1_sent_pwm", "rc2_sent_pwm", "rc3_sent_pwm", "rc4_sent_pwm")
UNTOLD = frozenset({*_STICKS, *_DENIED})
"""No log tells sticks and switches that order something from those that fly, or what was asked and denied."""
NO_ORDERS = {
    **dict.fromkeys(_STICKS, "no message: what a stick or switch ordered is not logged as such"),
    **dict.fromkeys(_DENIED, "no message: what was ordered and denied is not logged"),
}

Points = list[tuple[float, float]]


class FlightLog(NamedTuple):
    """A log as it was read.

    Attributes:
        trace: the signals, 20 a second.
        stimuli: parameters that were changed and commands that were given in flight, times from the trace's start.
        sources: by signal, the message or parameter of the autopilot it is read from, whether this log has it or not.
        crashed: the autopilot itself said so at the end.
        untold: signals made of orders that this log does not keep: that it shows none does not say that none was given.
        lost: in words, what of the log is damaged and was left out.
    """

    trace: Trace
    stimuli: tuple[Stimulus, ...] = ()
    sources: Mapping[str, str] = {}
    crashed: bool = False
    untold: frozenset[str] = frozenset()
    lost: tuple[str, ...] = ()


def changed_by_hand(name: str) -> bool:
    """Say whether a parameter is one that people set, not one in which the autopilot keeps what it learnt."""
    return not name.startswith(_OWN_PREFIXES) and not name.endswith(_OWN_SUFFIXES)


def within(stimuli: Iterable[Stimulus], start_s: float, end_s: float) -> tuple[Stimulus, ...]:
    """Return what was given from `start_s` to `end_s`, in order, with times from `start_s`."""
    found = sorted((one for one in stimuli if start_s <= one.at_s <= end_s), key=lambda one: one.at_s)
    return tuple(Stimulus(at_s=one.at_s - start_s, kind=one.kind, name=one.name, values=one.values) for one in found)


def add_taken_off(columns: Columns) -> None:
    """Add `taken_off` where arming and standing are known: 1 once off the ground since the motors were armed."""
    armed, landed = columns.get("armed"), columns.get("landed")
    if armed is None or landed is None:
        return
    times = np.union1d(armed[0], landed[0])
    is_armed, stands = (_held_at(column, times) > 0 for column in (armed, landed))
    off, flags = False, []
    for motors, ground in zip(is_armed, stands, strict=True):
        off = bool(motors) and (off or not ground)
        flags.append(float(off))
    columns.hold("taken_off", times, flags)


def begins_in_flight(columns: Columns) -> bool:
    """Say whether the first thing a log tells of the vehicle is that it flies: armed, and not standing."""
    armed, landed = columns.get("armed"), columns.get("landed")
    return armed is not None and landed is not None and armed[1][0] > 0 and landed[1][0] <= 0


def told_of(table: Mapping[str, str], logged: Container[str], columns: Columns) -> dict[str, str]:
    """Return where each signal comes from; of one whose message is logged and does not tell it here, that, too.

    Args:
        table: by signal the messages it may stand in, in words.
        logged: the names of the messages in the log.
        columns: what was read.
    """
    return {
        signal: f"{source}: logged, without a value" if signal not in columns and _is_of(source, logged) else source
        for signal, source in table.items()
    }


def _is_of(source: str, logged: Container[str]) -> bool:
    return any(word.split(".")[0] in logged for word in source.replace(",", " ").split())


def stands_by_height(columns: Columns, armed: Points) -> Points:
    """Return when a vehicle stood, from motors and height, for logs that say when it landed but not when it left.

    It stands until it is first more than 1 m above the place of arming, and again when it is disarmed.
    """
    height = columns.get("altitude_m") or columns.get("baro_altitude_m")
    points: Points = [(0.0, 1.0)]
    for number, (at_s, motors) in enumerate(armed):
        if not motors:
            points.append((at_s, 1.0))
        elif height is not None:
            until_s = armed[number + 1][0] if number + 1 < len(armed) else np.inf
            times, values = height
            ground = float(np.interp(at_s, times, values))
            first, last = np.searchsorted(times, [at_s, until_s])
            off = np.flatnonzero(values[first:last] > ground + _LEFT_GROUND_M)
            points += [(float(times[first + off[0]]), 0.0)] if len(off) else []
    return points


def _held_at(column: tuple[np.ndarray, np.ndarray], times: np.ndarray) -> np.ndarray:
    at, values = column
    found: np.ndarray = values[np.maximum(np.searchsorted(at, times + 1e-9, side="right") - 1, 0)]
    return found
