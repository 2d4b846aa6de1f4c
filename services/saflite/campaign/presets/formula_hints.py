"""What the text of a rule tells a search before any flight: modes, failsafes, settings and quiet it asks for.

Read as text: slices do not import each other, and the oracle's own reader checks the same formula fully.
"""

from __future__ import annotations

import re
from typing import Any

from saflite.contract.signals import SIGNALS
from saflite.contract.target_info import InputInfo, TargetInfo

QUIET_MAX_S = 45.0
_MODE = re.compile(r"\bmode\s*==\s*([A-Z_0-9]+)")
_FAILSAFE = re.compile(r"\bfailsafe_([a-z]+)\s*==\s*1\b")
_LASTING = re.compile(r"\b(?:lasting|historically)\s*\[\s*(?:[\d.]+\s*:\s*)?([\d.]+)")
_AFTER = re.compile(r"\b[a-z_]*(?:quiet|calm|order)_s\s*>=?\s*([\d.]+)")
_AHEAD = re.compile(r"\b(?:eventually|always)\s*\[\s*[\d.]+\s*:\s*([\d.]+)")
_COMPARED = re.compile(r"\b([a-z_0-9]+)\s*(==|>=|<=)\s*([\d.]+)\b")
SETTING = re.compile(r"\b[A-Za-z][A-Za-z0-9]*_[A-Za-z0-9_]+\b")


def whole_formula(data: dict[str, Any]) -> str:
    """Return a rule's formula with its named parts, constants as numbers."""
    terms = data.get("terms", {})
    text = "\n".join([str(data.get("formula", "")), *map(str, terms.values() if isinstance(terms, dict) else ())])
    constants = data.get("constants", {})
    for name, value in constants.items() if isinstance(constants, dict) else ():
        text = re.sub(rf"\b{re.escape(name)}\b", str(value), text)
    return text


def modes_named(formula: str) -> tuple[str, ...]:
    """Return the modes a formula asks for, in its order."""
    return tuple(dict.fromkeys(_MODE.findall(formula)))


def failsafes_named(formula: str) -> tuple[str, ...]:
    """Return the failsafes a formula asks to be raised."""
    return tuple(name for name in dict.fromkeys(_FAILSAFE.findall(formula)) if f"failsafe_{name}" in SIGNALS)


def quiet_asked_s(formula: str) -> float:
    """Return for how long a state must last, undisturbed, until the rule speaks and its promise is due."""
    parts = ([float(text) for text in pattern.findall(formula)] for pattern in (_LASTING, _AFTER, _AHEAD))
    return min(QUIET_MAX_S, sum(max(found, default=0.0) for found in parts))


def settings_asked(formula: str, target: TargetInfo) -> tuple[tuple[InputInfo, float], ...]:
    """Return parameters with a value a formula compares them to: codes and flags, and 0 of any unit; no defaults."""
    inputs = {entry.name: entry for entry in target.inputs if entry.kind == "parameter"}
    found: dict[tuple[str, float], InputInfo] = {}
    for signal, _, number in _COMPARED.findall(formula):
        known, value = SIGNALS.get(signal, target.own_signals.get(signal)), float(number.rstrip("."))
        if known is None or (known.unit and value) or signal.endswith("_true"):
            continue
        for name in SETTING.findall(known.meaning):
            if name in inputs and inputs[name].default != value:
                found[name, value] = inputs[name]
    return tuple((entry, value) for (_, value), entry in found.items())
