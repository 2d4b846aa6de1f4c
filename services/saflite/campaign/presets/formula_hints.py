"""What the text of a rule tells a search before any flight: modes, failsafes, settings and quiet it asks for.

Read as text: slices do not import each other, and the oracle's own reader checks the same formula fully.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from saflite.contract.signals import FAILSAFES, SIGNALS
from saflite.contract.target_info import InputInfo, TargetInfo

QUIET_MAX_S = 85.0
DOWN_S = 50.0  # for a vehicle to come to the ground from some ten metres, home first
DUE_S = 1.0  # after a time that a rule allows its promise is due
_BARRED = re.compile(r"\bmode\s*!=\s*([A-Z_0-9]+)")
_MODE = re.compile(r"\bmode\s*==\s*([A-Z_0-9]+)")
_TURNED = re.compile(r"\b(?:rise|fall)\s*\(+\s*mode\s*==\s*([A-Z_0-9]+)")
_TOUCHES = re.compile(r"\brise\s*\(+\s*landed\s*==\s*1\b")
_FAILSAFE = re.compile(r"\bfailsafe_([a-z]+)\s*==\s*1\b")
_LASTING = re.compile(r"\b(?:lasting|historically)\s*\[\s*(?:[\d.]+\s*:\s*)?([\d.]+)")
_AFTER = re.compile(r"\b[a-z_]*(?:quiet|calm|order)_s\s*>=?\s*([\d.]+)")
_AHEAD = re.compile(r"\b(?:eventually|always)\s*\[\s*[\d.]+\s*:\s*([\d.]+)")
_COMPARED = re.compile(r"\b([a-z_0-9]+)\s*(==|>=|<=)\s*([\d.]+)\b")
_STICK = re.compile(r"\brc([1-4])_pwm\s*(>=?|<=?)\s*(?:([\d.]+)|([a-z_]+))")
_STICK_MIDDLE = 1500.0
_STICK_CLEAR = 50.0  # what is asked nearer to the middle is met with the stick let go
_SUM = re.compile(r"(?<![\w.*/)] )(?<![\w.*/)-])(\d+(?:\.\d+)?) ([+-]) (\d+(?:\.\d+)?)(?! ?[*/]|[\w.])")
_BESIDE = re.compile(r"\b([a-z_0-9]+)\s*(>=?|<=?)\s*\(?\s*(?:latch\(\s*)?([a-z_0-9]+)\b")
_KEPT = re.compile(r"\(?\blatch\(\s*([a-z_0-9]+)\s*,[^()]*\)\)?")  # a value as it was at some moment
_LOST = re.compile(r"\b[a-z]+_(?:ok|present)\s*==\s*0\b(?!\s*or\b)")
_SILENT = re.compile(r"\b([a-z]+)_(?:ok|present)\s*==\s*0\b")
_PROMISED = re.compile(r"\bimplies\s+(?:prev\(\s*)?(?:\(\s*)?[a-z]+_(?:ok|present)\s*==\s*1\b")
_FAR = re.compile(r"\bhome_distance_m\s*>=?\s*([\d.]+)\b")
TERMS_DEEP, TEXT_MAX = 6, 100_000
SETTING = re.compile(r"\b[A-Za-z][A-Za-z0-9]*_[A-Za-z0-9_]+\b")


_SCALES = {("m", "cm"): 100.0, ("m/s", "cm/s"): 100.0, ("s", "ms"): 1000.0, ("deg", "cdeg"): 100.0}


def whole_formula(data: dict[str, Any]) -> str:
    """Return a rule's formula with its named parts, constants as numbers."""
    terms = data.get("terms", {})
    text = "\n".join([str(data.get("formula", "")), *map(str, terms.values() if isinstance(terms, dict) else ())])
    return with_numbers(text, data)


def antecedents(data: dict[str, Any]) -> str:
    """Return what a rule asks for before it speaks: what stands before each `implies`, named parts put in their places.

    Of several promises joined by `and` those between stay; a rule without conditions is returned whole.
    """
    terms = data.get("terms", {})
    text = str(data.get("formula", ""))
    named = {str(name): str(part) for name, part in terms.items()} if isinstance(terms, dict) else {}
    any_term = _any_of(tuple(named))
    for _ in range(TERMS_DEEP):
        before = text
        text = any_term.sub(lambda found: f"({named[found[0]]})", text)
        if text == before or len(text) > TEXT_MAX:
            break
    before, promise, _ = text.rpartition(" implies ")
    return with_numbers(before if promise else text, data)


def with_numbers(text: str, data: dict[str, Any]) -> str:
    """Return a formula with its constants as numbers, and sums and differences of two numbers worked out."""
    constants = data.get("constants", {})
    values = {str(name): str(value) for name, value in constants.items()} if isinstance(constants, dict) else {}
    text = _any_of(tuple(values)).sub(lambda found: values[found[0]], text)
    return _SUM.sub(_worked_out, text)


@cache
def _any_of(names: tuple[str, ...]) -> re.Pattern[str]:
    """Return what matches each of the names where it is a word of its own; nothing if there are none."""
    return re.compile(rf"\b(?:{'|'.join(map(re.escape, names))})\b" if names else r"(?!)")


def _worked_out(sum_: re.Match[str]) -> str:
    left, how, right = sum_.groups()
    return f"{float(left) + float(right) if how == '+' else float(left) - float(right):g}"


def modes_named(formula: str) -> tuple[str, ...]:
    """Return the modes a formula asks for, in its order; where it waits for one to begin or end that one alone."""
    return tuple(dict.fromkeys(_TURNED.findall(formula) or _MODE.findall(formula)))


def modes_barred(formula: str) -> tuple[str, ...]:
    """Return the modes in which a formula says that something must not be."""
    return tuple(dict.fromkeys(_BARRED.findall(formula)))


def failsafes_named(formula: str) -> tuple[str, ...]:
    """Return the failsafes a formula asks to be raised."""
    return tuple(name for name in dict.fromkeys(_FAILSAFE.findall(formula)) if f"failsafe_{name}" in FAILSAFES)


def quiet_asked_s(formula: str, constants: dict[str, Any] | None = None) -> float:
    """Return for how long a state must last, undisturbed, until the rule speaks and its promise is due.

    No less than the longest time among the rule's constants (named with `_s` last), which its promise may wait for.
    """
    parts = ([float(text) for text in pattern.findall(formula)] for pattern in (_LASTING, _AFTER, _AHEAD))
    times = [float(value) for name, value in (constants or {}).items() if name.endswith("_s") and _is_time(value)]
    longest = max(times, default=-DUE_S) + DUE_S
    if _TOUCHES.search(formula):
        longest = max(longest, DOWN_S)
    return min(QUIET_MAX_S, max(longest, sum(max(found, default=0.0) for found in parts)))


def _is_time(value: Any) -> bool:
    return isinstance(value, int | float) and 0.0 < value <= QUIET_MAX_S


def sticks_held(formula: str, target: TargetInfo) -> tuple[tuple[InputInfo, float], ...]:
    """Return sticks that a formula asks to be held well off the middle, with a value that does: an end.

    Where it compares one with a signal that shows a setting, a little to that side of the setting's default.
    """
    sticks = {entry.name: entry for entry in target.inputs if entry.kind == "stick"}
    found: dict[tuple[str, float], InputInfo] = {}
    for channel, how, number, signal in _STICK.findall(formula):
        entry, above = sticks.get(f"RC{channel}"), how.startswith(">")
        if entry is None or entry.low is None or entry.high is None:
            continue
        off = float(number.rstrip(".")) - _STICK_MIDDLE if number else 0.0
        if abs(off) > _STICK_CLEAR and (off > 0.0) == above:
            found[entry.name, entry.high if above else entry.low] = entry
        for setting in _shown_by(signal, target):
            found[entry.name, setting + (_STICK_CLEAR if above else -_STICK_CLEAR) / 2.0] = entry
    return tuple((entry, value) for (_, value), entry in found.items())


def settings_pushed(formula: str, target: TargetInfo) -> tuple[tuple[InputInfo, float], ...]:
    """Return the parameters that a state is compared with, and the sense (1, -1) in which setting them makes it true.

    A height above the ceiling of a fence comes of climbing, or of a low ceiling: the setting can be had anywhere.
    """
    inputs = {entry.name: entry for entry in target.inputs if entry.kind == "parameter"}
    found: dict[tuple[str, float], InputInfo] = {}
    for state, how, setting in _BESIDE.findall(formula):
        shown = SIGNALS.get(setting, target.own_signals.get(setting))
        if shown is None or not shown.unit or not (state in SIGNALS or state in target.own_signals):
            continue
        if any(name in inputs for name in _names_in(state, target)):
            continue  # two settings side by side, or a command's speed: neither is a state
        for name in _names_in(setting, target):
            if name in inputs:
                found[name, -1.0 if how.startswith(">") else 1.0] = inputs[name]
    return tuple((entry, sense) for (_, sense), entry in found.items())


def _names_in(signal: str, target: TargetInfo) -> list[str]:
    known = SIGNALS.get(signal, target.own_signals.get(signal))
    return SETTING.findall(known.meaning) if known is not None else []


def sensor_lost(data: dict[str, Any]) -> bool:
    """Return whether a rule is about a sensor or link that is lost: it asks for that, or promises that it is not."""
    return bool(_LOST.search(antecedents(data)) or _PROMISED.search(whole_formula(data)))


def faults_asked(formula: str, target: TargetInfo) -> tuple[str, ...]:
    """Return the sensor faults of a target named after a sensor or link that a formula asks to be lost."""
    words = [f"_{word.upper()}_" for word in dict.fromkeys(_SILENT.findall(formula))]
    faults = [entry.name for entry in target.inputs if entry.kind == "sensor_fault"]
    return tuple(name for name in faults if any(word in f"{name}_" for word in words))


def far_asked_m(formula: str, target: TargetInfo) -> float:
    """Return how far from home a formula wants the vehicle, 0 where it does not say.

    Where it compares the distance with a setting it is the least one that can be set.
    """
    inputs = {entry.name: entry for entry in target.inputs if entry.kind == "parameter"}
    asked = [float(text) for text in _FAR.findall(formula)]
    for state, how, setting in _BESIDE.findall(formula):
        if state == "home_distance_m" and how.startswith(">"):
            named = [inputs[name] for name in _names_in(setting, target) if name in inputs]
            asked += [entry.low / _SCALES.get(("m", entry.unit), 1.0) for entry in named if entry.low is not None]
    return max(asked, default=0.0)


def _shown_by(signal: str, target: TargetInfo) -> list[float]:
    """Return the defaults of the settings that a signal shows."""
    known = SIGNALS.get(signal, target.own_signals.get(signal))
    names = SETTING.findall(known.meaning) if known is not None else []
    defaults = {entry.name: entry.default for entry in target.inputs if entry.kind == "parameter"}
    return [default for name in names if (default := defaults.get(name)) is not None]


def settings_asked(formula: str, target: TargetInfo) -> tuple[tuple[InputInfo, float], ...]:
    """Return parameters with a value a formula compares them to, no defaults.

    Codes, flags, and 0 of any unit; of a size the double of what the formula asks for at least, where the parameter is
    smaller by default.
    """
    inputs = {entry.name: entry for entry in target.inputs if entry.kind == "parameter"}
    found: dict[tuple[str, float], InputInfo] = {}
    for signal, how, number in _COMPARED.findall(_KEPT.sub(r"\1", formula)):
        known, asked = SIGNALS.get(signal, target.own_signals.get(signal)), float(number.rstrip("."))
        if known is None or signal.endswith("_true"):
            continue
        for name in SETTING.findall(known.meaning):
            entry = inputs.get(name)
            if entry is None or entry.default is None:
                continue
            value = asked if not (known.unit and asked) else _enough(asked, how, known.unit, entry)
            if value is not None and entry.default != value:
                found[name, value] = entry
    return tuple((entry, value) for (_, value), entry in found.items())


def _enough(asked: float, how: str, unit: str, entry: InputInfo) -> float | None:
    """Return twice what is asked for in the parameter's unit; None where its default is enough or it cannot be had."""
    scale = 1.0 if entry.unit == unit else _SCALES.get((unit, entry.unit))
    if how != ">=" or scale is None or entry.default is None or entry.default >= asked * scale:
        return None
    value = 2.0 * asked * scale
    return value if (entry.high is None or value <= entry.high) else None
