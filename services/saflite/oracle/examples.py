"""Examples in policy files: little made-up traces that a formula must find kept or broken."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import msgspec
import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.signals import MODES, Signal
from saflite.oracle.effects import FLAGS
from saflite.oracle.orders import SETTINGS
from saflite.oracle.settling import braking_mps2, settling
from saflite.oracle.windows import Array

_SAMPLES_MAX = 10_000
_QUIET: dict[str, float] = {
    **dict.fromkeys(("quiet_s", "order_quiet_s", "calm_s"), 100.0),
    **dict.fromkeys(("home_quiet_s", "command_quiet_s", "pause_order_s", "start_order_s", "stop_order_s"), 1e6),
    **dict.fromkeys(("divert_order_s", "climb_order_s", "height_order_s", "plain_order_s"), 1e6),
    **dict.fromkeys(("plain_order", "plain_order_refused", "position_aided"), 0.0),
    **{f"rc{channel}_sent_pwm": 0.0 for channel in (1, 2, 3, 4)},
    **dict.fromkeys(FLAGS, 1.0),
    **dict.fromkeys(("stop_ordered", "arming_forced"), 0.0),
    **{name: row.default * row.unit for name, row in SETTINGS.items()},
    "return_speed_set_mps": SETTINGS["cruise_speed_set_mps"].default * SETTINGS["cruise_speed_set_mps"].unit,
}
"""Examples need not say that nothing was done lately and nothing is broken; `time_s` is always made,
`stopping_s` and `settling_s` where they are not given, of the speed and the usual settings."""
Value = float | str


class Wave(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A signal that swings: mean + size * sin(2 pi (t + ahead_s) / period_s)."""

    mean: float
    size: float
    period_s: Annotated[float, msgspec.Meta(ge=1e-3, le=1e6)]
    ahead_s: float = 0.0


Course = Value | Wave | list[tuple[float, Value]]


class Example(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A trace and what the formula must say of it.

    `signals` gives each signal a constant or a list of [time, value]: real signals run in straight lines between the
    points, flags and codes keep a value until the next; `{mean, size, period_s}` swings, `ahead_s` earlier than a sine.
    Modes may be given by name. `like` is the number of an earlier example, from 1, whose signals are taken over but
    for those given. `applies` is false for examples that show where the rule does not apply.
    """

    holds: bool
    why: str
    duration_s: float
    signals: dict[str, Course] = {}
    like: int = 0
    step_s: float = 0.1
    applies: bool = True


def completed(examples: Sequence[Example], number: int, where: str) -> Example:
    """Return example `number`, from 1, with what it takes over; raises Refused if that is no earlier one."""
    example = model = examples[number - 1]
    signals = dict(example.signals)
    while model.like:  # no recursion: a chain may be longer than the stack
        if not 0 < model.like < number:
            expected = "the number of an earlier one"
            raise Refused(f"example {number} like", where=where, expected=expected, got=model.like)
        number, model = model.like, examples[model.like - 1]
        for name, course in model.signals.items():
            signals.setdefault(name, course)
    return msgspec.structs.replace(example, signals=signals, like=0)


def example_signals(
    example: Example, wanted: frozenset[str], name: str, where: str, table: Mapping[str, Signal]
) -> dict[str, Array]:
    """Return the example's signals as arrays of shape (samples,); `table` has a row for each.

    The ground is level where an example does not say otherwise.

    Raises:
        Refused: a wanted signal is missing, one is too many, the times do not rise, or the trace is too long.
    """
    courses: dict[str, Course] = {
        **{name: value for name, value in _QUIET.items() if name in wanted},
        **example.signals,
    }
    if "above_ground_m" in wanted and "altitude_m" in courses:
        courses.setdefault("above_ground_m", courses["altitude_m"])
    made_here = (wanted & {"time_s", "stopping_s", "settling_s"}) - frozenset(courses)
    given = frozenset(courses) | made_here
    if given != wanted:
        expected = f"exactly the signals {', '.join(sorted(wanted))}"
        raise Refused(name, where=where, expected=expected, got=", ".join(sorted(given ^ wanted)) + " amiss")
    if not (0 < example.step_s <= example.duration_s < example.step_s * _SAMPLES_MAX):
        raise Refused(name, where=where, expected=f"1 to {_SAMPLES_MAX} samples", got=f"{example.duration_s:g} s")
    count = math.floor(example.duration_s / example.step_s + 1e-9) + 1
    times = np.arange(count, dtype=np.float64) * np.float64(example.step_s)
    made = {
        signal: _course(signal, course, times, table[signal].kind == "real", name, where)
        for signal, course in courses.items()
    }
    usual = [SETTINGS[name].default * SETTINGS[name].unit for name in ("acceleration_set_mps2", "angle_max_set_deg")]
    braking = braking_mps2(*(np.full(count, value) for value in usual))
    level = np.zeros(count)
    ours = {"time_s": times, **settling(made.get("ground_speed_mps", level), made.get("tilt_deg", level), braking)}
    return {**made, **{name: ours[name] for name in made_here}}


def _course(signal: str, course: Course, times: Array, real: bool, name: str, where: str) -> Array:
    if isinstance(course, Wave):
        return course.mean + course.size * np.sin(2.0 * math.pi / course.period_s * (times + course.ahead_s))
    points = course if isinstance(course, list) else [(0.0, course)]
    at = np.array([point[0] for point in points], dtype=np.float64)
    values = np.array([_number(signal, point[1], name, where) for point in points], dtype=np.float64)
    if len(at) == 0 or at[0] > 0 or np.any(np.diff(at) < 0):
        raise Refused(f"{name} {signal}", where=where, expected="times that rise from 0", got=at.tolist())
    if real:
        return np.interp(times, at, values)
    return values[np.searchsorted(at, times + 1e-9, side="right") - 1]


def _number(signal: str, value: Value, name: str, where: str) -> float:
    if isinstance(value, str):
        if signal != "mode" or value not in MODES:
            raise Refused(f"{name} {signal}", where=where, expected="a number, or a mode by name", got=repr(value))
        return float(MODES[value])
    return float(value)
