"""Faults a stranger might plant (`data/rule_faults.toml`), each with a flight that reaches it: which rules see it?"""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, get_args

import msgspec
from _authored_faults import PACKAGE, Patch
from _blind_faults import planted

from saflite.conformance.flying import fly_once
from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.test_case import (
    Mission,
    MissionItem,
    Scenario,
    StartState,
    Stimulus,
    StimulusKind,
    Target,
    TestCase,
    Twin,
    identity,
)
from saflite.flight.mission import dump_plan, parse_plan
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG
from saflite.oracle.judge import judge
from saflite.oracle.policy import policy_names

FILE = Path(__file__).parent / "data" / "rule_faults.toml"
LIMIT_S, MISSION_LIMIT_S = 75.0, 180.0
TWINS: tuple[Twin, ...] = ("turned", "idle", "afresh", "mirrored", "recalibrated")


class RuleFault(NamedTuple):
    """One changed line and the flight that reaches it."""

    patch: Patch
    flight: TestCase


@cache
def rule_faults() -> dict[str, RuleFault]:
    """Return the faults by name."""
    table = tomllib.loads(FILE.read_text(encoding="utf-8"))
    missions = table.pop("missions", {})
    return {name: RuleFault(_patch(name, row), _flight(row["flight"], missions)) for name, row in table.items()}


def _patch(name: str, row: dict[str, Any]) -> Patch:
    module = f"{PACKAGE}.{row['file'].replace('/', '.')}"
    return Patch(name, module, row["function"], row["old"], row["new"])


def _flight(rows: list[str], missions: dict[str, Any]) -> TestCase:
    """Return a flight from its rows: the start (mode, height, `disarmed`; or MISSION and its name), then inputs."""
    mode, _, what = rows[0].partition(" ")
    mission = _mission(what, missions[what]) if mode == "MISSION" else None
    height_m, _, disarmed = what.partition(" ")
    start = None if mission else StartState(mode=mode, altitude_m=float(height_m), armed=not disarmed)
    limit_s = MISSION_LIMIT_S if mission else LIMIT_S
    scenario = Scenario(start=start, mission=mission, time_limit_s=limit_s)
    return TestCase(target=Target(), scenario=scenario, stimuli=tuple(_stimulus(row) for row in rows[1:]))


def _stimulus(row: str) -> Stimulus:
    at_s, kind, name, *values = row.split()
    if kind not in get_args(StimulusKind):  # the vehicle would take it for a sensor's fault, the rules for nothing
        raise Refused("flight", where=row, expected=f"one of {', '.join(get_args(StimulusKind))}", got=repr(kind))
    name = f"MAV_CMD_{name}" if kind == "command" else name
    numbers = tuple(float(value) for value in values)
    return Stimulus(at_s=float(at_s), kind=kind, name=name, values=numbers)  # type: ignore[arg-type]


def _mission(name: str, lines: list[str]) -> Mission:
    """Return a mission from its items, each a MAV_CMD number and its seven numbers, heights above home."""
    rows = [tuple(float(word) for word in line.split()) for line in lines]
    items = tuple(MissionItem(command=int(row[0]), params=(*row[1:], *[0.0] * 7)[:7]) for row in rows)
    whole = Mission(name=name, home_lat_deg=HOME_LAT_DEG, home_lon_deg=HOME_LON_DEG, home_alt_m=0.0, items=items)
    return parse_plan(dump_plan(whole), name, name)


def seen_by(name: str) -> dict[str, Any]:
    """Return the rules that see a fault in its flight, and those that are broken in it without the fault."""
    fault = rule_faults()[name]
    with planted([fault.patch]):
        seen = _broken(fault.flight)
    return {"part": "planted", "fault": name, "seen_by": seen, "without_it": _broken(fault.flight)}


def _broken(case: TestCase) -> list[str]:
    """Return the rules that a flight breaks alone or with a twin of either kind."""
    return sorted({name for twin in TWINS for name in _broken_with(msgspec.structs.replace(case, twin=twin))})


def _broken_with(case: TestCase) -> list[str]:
    record = fly_once(case)
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    return [
        one.policy for one in judge(case, flight, record.trace, policy_names()).verdicts if one.outcome == "violated"
    ]
