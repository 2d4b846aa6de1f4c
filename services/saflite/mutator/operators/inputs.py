"""Which inputs may be given: those the target describes, and the lists PGFuzz publishes per policy. No drawing."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.signals import MODES
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import Setting, StimulusKind

PUBLISHED_FILE = Path(__file__).parent.parent / "data" / "published_inputs.csv"
MODE_COMMAND = "Flight_Mode"
WHOLE_MAX = 1e18
"""Of the range of an input of whole numbers: beyond what any takes, within what can be drawn from."""

STICKS = ("RC1", "RC2", "RC3", "RC4")


class Input(NamedTuple):
    """One input. Bounds are NaN where none are known; `whole` marks values that are whole numbers.

    `choices` are the only valid values, if there are such; `rest` is what a stick goes back to when it is let go;
    `at_start` marks what is given at 0 s only.
    """

    kind: StimulusKind
    name: str
    low: float = math.nan
    high: float = math.nan
    whole: bool = False
    choices: tuple[float, ...] = ()
    rest: float = math.nan
    at_start: bool = False


class Published(NamedTuple):
    """One row of the published lists."""

    autopilot: str
    group: str
    name: str
    number: str
    low: float
    high: float
    whole: bool
    policies: frozenset[str]


# ---- the published lists ------------------------------------------------------------------------------------------


@cache
def _rows() -> tuple[Published, ...]:
    with PUBLISHED_FILE.open(newline="", encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    every: dict[str, set[str]] = {}
    for row in table:
        names = row["policies"].replace("all but", "").replace("all", "").split()
        every.setdefault(row["autopilot"], set()).update(names)
    return tuple(_row(row, every[row["autopilot"]]) for row in table)


def _row(row: dict[str, str], every: set[str]) -> Published:
    words = row["policies"].split()
    named = set(words) - {"all", "but"}
    low, high = row["low"], row["high"]
    return Published(
        autopilot=row["autopilot"],
        group=row["class"],
        name=row["name"],
        number=row["number"],
        low=float(low) if low else math.nan,
        high=float(high) if high else math.nan,
        whole="." not in low + high,
        policies=frozenset(every - named if words[0] == "all" else named),
    )


@cache
def published_policies() -> tuple[str, ...]:
    """Return the policies there is a published list for, sorted."""
    return tuple(sorted(frozenset[str]().union(*(row.policies for row in _rows()))))


def published_inputs(policy: str) -> tuple[Input, ...]:
    """Return the inputs of a policy's published list; raises Refused if there is no such list."""
    if policy not in published_policies():
        raise Refused("published", expected=f"one of {', '.join(published_policies())}", got=repr(policy))
    unique: dict[tuple[StimulusKind, str], Input] = {}
    for entry in (_as_input(row) for row in _rows() if policy in row.policies):
        unique.setdefault((entry.kind, entry.name), entry)
    return tuple(unique.values())


def _as_input(row: Published) -> Input:
    if row.name == MODE_COMMAND:
        names = {number: name for name, number in MODES.items()}
        return Input("mode", names.get(int(row.number or -1), f"MODE_{row.number}"))
    if row.name in STICKS:
        return Input("stick", row.name)
    if row.group == "command":
        return Input("command", row.name)
    kind: StimulusKind = "sensor_fault" if row.group == "environment" else "parameter"
    return Input(kind, row.name, row.low, row.high, row.whole)


# ---- what the target has ------------------------------------------------------------------------------------------

Have = dict[tuple[StimulusKind, str], Input]


def target_inputs(target: TargetInfo, settings: Mapping[str, Setting]) -> Have:
    """Return every input that can be given with these settings of the target, in its order.

    Raises Refused for a range that is none.
    """
    without = target.lacking(settings)
    return {(entry.kind, entry.name): _described(entry) for entry in target.inputs if entry.name not in without}


def _described(entry: InputInfo) -> Input:
    low, high = (0.0, 1.0) if entry.type == "flag" else (entry.low, entry.high)
    wide = [bound for bound in (low, high) if bound is not None and abs(bound) > WHOLE_MAX]
    if entry.type == "whole" and wide:
        raise Refused(f"input {entry.name}", expected=f"whole numbers within +-{WHOLE_MAX:g}", got=wide[0])
    if low is not None and high is not None and low > high:
        raise Refused(f"input {entry.name}", expected="a least value at most the greatest", got=f"{low:g} and {high:g}")
    return Input(
        kind=entry.kind,
        name=entry.name,
        low=math.nan if low is None else low,
        high=math.nan if high is None else high,
        whole=entry.type in ("whole", "flag"),
        choices=entry.choices,
        rest=entry.default if entry.kind == "stick" and entry.default is not None else math.nan,
        at_start=entry.at_start,
    )


def on_target(wanted: tuple[Input, ...], have: Have) -> tuple[Input, ...]:
    """Return those of the wanted inputs the target has, with the target's own ranges."""
    return tuple(have[(entry.kind, entry.name)] for entry in wanted if (entry.kind, entry.name) in have)


def named(kind: StimulusKind, names: list[str], have: Have, setting: str) -> tuple[Input, ...]:
    """Return the inputs a setting names; raises Refused for one the target does not have.

    `Flight_Mode` among commands stands for all modes, `RC1`..`RC4` for sticks, as in the published lists.
    """
    found: list[Input] = []
    for name in names:
        if kind == "command" and name == MODE_COMMAND:
            found.extend(entry for entry in have.values() if entry.kind == "mode")
            continue
        key: tuple[StimulusKind, str] = ("stick" if kind == "command" and name in STICKS else kind, name)
        if key not in have:
            known = sorted(known for other, known in have if other == kind)
            expected = f"a {kind} of the target: {_some(known) or 'it has none'}"
            raise Refused(f"strategy setting {setting}", expected=expected, got=repr(name), known=known)
        found.append(have[key])
    return tuple(found)


def _some(names: list[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f", ... ({len(names)} in all)" if len(names) > most else "")
