"""Which inputs may be given: the target's own, and the lists PGFuzz publishes per policy. Pure facts, no drawing."""

from __future__ import annotations

import csv
import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.signals import MODES
from saflite.contract.test_case import StimulusKind

PUBLISHED_FILE = Path(__file__).parent.parent / "data" / "published_inputs.csv"
FAULT_PREFIX, COMMAND_PREFIX, MODE_COMMAND = "SIM_", "MAV_CMD_", "Flight_Mode"
STICKS = ("RC1", "RC2", "RC3", "RC4")
STICK_LOW_PWM, STICK_HIGH_PWM, STICK_CENTRE_PWM = 1000.0, 2000.0, 1500.0
COMMANDS_EVERYWHERE = ("MAV_CMD_DO_REPOSITION", "MAV_CMD_NAV_LAND", "MAV_CMD_NAV_TAKEOFF", "MAV_CMD_DO_PARACHUTE")
REFERENCE = "reference"
_SWITCHES = (
    *("_ENABLE", "_ENABLED", "_DISABLE", "_TYPE", "_OPTIONS", "_ACTION", "_BOOST", "_TRAINER", "_SOURCE", "_BHV"),
    *("_PRIMARY", "_NUMSATS", "_SATS_MIN", "_NAVFILTER", "_FAIL"),
)
_WHOLE_UNITS = frozenset({"cm", "cm/s", "ms", "us", "cdeg"})
NOT_ON_REFERENCE = frozenset({"DRIFT", "SPORT"})


class Input(NamedTuple):
    """One input. Bounds are NaN where none are known; `whole` marks values that are whole numbers."""

    kind: StimulusKind
    name: str
    low: float = math.nan
    high: float = math.nan
    whole: bool = False


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
        return stick(row.name)
    if row.group == "command":
        return Input("command", row.name)
    kind: StimulusKind = "sensor_fault" if row.group == "environment" else "parameter"
    return Input(kind, row.name, row.low, row.high, row.whole)


# ---- what the target has ------------------------------------------------------------------------------------------


def stick(name: str) -> Input:
    """Return a stick channel, pulses in microseconds."""
    return Input("stick", name, STICK_LOW_PWM, STICK_HIGH_PWM, whole=True)


@cache
def target_inputs(target: str) -> dict[tuple[StimulusKind, str], Input]:
    """Return every input a target has. Targets other than the reference: all that is published for both autopilots."""
    inputs = [stick(name) for name in STICKS]
    if target == REFERENCE:
        inputs += [Input("command", f"{COMMAND_PREFIX}{name}") for name in sorted(_reference_commands())]
        inputs += _reference_parameters()
        inputs += [Input("mode", name) for name in MODES if name not in NOT_ON_REFERENCE]
    else:
        inputs += [Input("command", name) for name in sorted(_command_names())]
        inputs += [Input("mode", name) for name in MODES]
        inputs += [_as_input(row) for row in _rows() if row.group != "command"]
    return {(entry.kind, entry.name): entry for entry in inputs}


def _command_names() -> set[str]:
    published = {row.name for row in _rows() if row.group == "command"}
    return (published | set(COMMANDS_EVERYWHERE)) - {MODE_COMMAND, *STICKS}


def _reference_commands() -> tuple[str, ...]:
    from saflite.flight.autopilots.reference.command_names import NAMES

    return tuple(NAMES)


def _reference_parameters() -> list[Input]:
    from saflite.flight.autopilots.reference.parameters import parameter_table

    return [
        Input(
            "sensor_fault" if row.name.startswith(FAULT_PREFIX) else "parameter",
            row.name,
            float(row.low),
            float(row.high),
            whole=row.unit in _WHOLE_UNITS or row.name.endswith(_SWITCHES),
        )
        for row in parameter_table().values()
    ]


def on_target(wanted: tuple[Input, ...], target: str) -> tuple[Input, ...]:
    """Return those of the wanted inputs the target has, with the target's own ranges."""
    have = target_inputs(target)
    return tuple(have[(entry.kind, entry.name)] for entry in wanted if (entry.kind, entry.name) in have)


def named(kind: StimulusKind, names: list[str], target: str, setting: str) -> tuple[Input, ...]:
    """Return the inputs a setting names; raises Refused for one the target does not have.

    `Flight_Mode` among commands stands for all modes, `RC1`..`RC4` for sticks, as in the published lists.
    """
    have = target_inputs(target)
    found: list[Input] = []
    for name in names:
        if kind == "command" and name == MODE_COMMAND:
            found.extend(entry for entry in have.values() if entry.kind == "mode")
        elif kind == "command" and name in STICKS:
            found.append(stick(name))
        elif (kind, name) in have:
            found.append(have[(kind, name)])
        elif target == REFERENCE or kind in ("stick", "mode"):
            known = sorted(known for other, known in have if other == kind)
            raise Refused(
                f"strategy setting {setting}", expected=f"{kind}s of {target}: {_some(known)}", got=repr(name)
            )
        else:
            found.append(Input(kind, name))
    return tuple(found)


def _some(names: list[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f", ... ({len(names)} in all)" if len(names) > most else "")
