"""A campaign for every policy that inputs can break on the reference target, and one over all of them at once.

The policy files are read as data (id, title, inputs, start, preconditions): slices do not import each other, and the
oracle's own reader checks the same files fully when a campaign runs.
"""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from saflite.contract.config import Campaign, ScorerConfig, SearchConfig, StrategyConfig, read_text
from saflite.contract.errors import Refused
from saflite.contract.test_case import StartState, Target
from saflite.contract.work import Setting
from saflite.flight.autopilots.reference.parameters import parameter_table

POLICIES_DIR = Path(__file__).parents[1] / "oracle" / "policies"
PREFIX, ALL = "policy-", "policy-all"
TARGET = "reference"
MISSION = "mission2"
SHORT_S, MISSION_S = 60.0, 150.0
AIRBORNE_S = 32.0  # with a mission the vehicle leaves the ground after 19.5 s and climbs for 7
_INPUTS = ("parameters", "commands", "sticks", "modes", "sensor_faults")
_SEARCH = SearchConfig(candidates_per_round=96, flights_per_round=16, shrink=True)


def policy_campaigns() -> dict[str, Campaign]:
    """Return the generated campaigns by name."""
    single = {name: _one(data) for name, data in _policies().items()}
    return {**single, ALL: _all([data for data in _policies().values() if not data.get("needs_mission")])}


@cache
def _policies() -> dict[str, dict[str, Any]]:
    """Return what stands in the files of the policies that stimuli can break on the reference target, by campaign."""
    found = {}
    for path in sorted(POLICIES_DIR.glob("*.toml")):
        try:
            data = tomllib.loads(read_text(path, "policy file"))
        except tomllib.TOMLDecodeError as fault:
            raise Refused("policy file", where=str(path), expected="TOML", got=str(fault)) from fault
        inputs = data.get("inputs", {})
        if TARGET not in data.get("not_checked_on", {}) and any(inputs.get(word) for word in _INPUTS):
            found[PREFIX + data["id"]] = data
    return found


def _one(data: dict[str, Any]) -> Campaign:
    settings: dict[str, Setting] = {word: _known(word, data["inputs"].get(word, ())) for word in _INPUTS}
    settings["published"] = data["inputs"].get("published", "")
    needs_mission = data.get("needs_mission", False)
    if needs_mission:
        settings["start_s"] = AIRBORNE_S
    start = data.get("start", {})
    return Campaign(
        name=PREFIX + data["id"],
        description=f"{data['title']}: which inputs break this rule? ({data['source']})",
        target=Target(parameters={name: float(value) for name, value in data.get("preconditions", {}).items()}),
        mission=MISSION if needs_mission else "",
        start=None if needs_mission else StartState(**start),
        time_limit_s=MISSION_S if needs_mission else SHORT_S,
        policies=(data["id"],),
        budget_flights=300,
        strategy=StrategyConfig(name="pgfuzz", settings=settings),
        scorer=ScorerConfig(model="relevance", batch=16),
        search=_SEARCH,
    )


def _known(word: str, names: list[str]) -> list[float | int | str | bool]:
    """Return the names without parameters that only other targets have; a policy file serves every target."""
    if word not in ("parameters", "sensor_faults"):
        return list(names)
    return [name for name in names if name in parameter_table()]


def _all(policies: list[dict[str, Any]]) -> Campaign:
    """Return the campaign that looks for whatever breaks any rule; inputs come from all the target has."""
    preconditions = {
        name: float(value) for data in policies for name, value in sorted(data.get("preconditions", {}).items())
    }
    return Campaign(
        name=ALL,
        description=f"Any input of the vehicle against {len(policies)} policies at once, led by the scorer's interest",
        target=Target(parameters=preconditions),
        start=StartState(mode="LOITER", altitude_m=30.0),
        time_limit_s=SHORT_S,
        policies=tuple(data["id"] for data in policies),
        budget_flights=2000,
        strategy=StrategyConfig(name="pgfuzz", settings={"focus": 0.0}),
        scorer=ScorerConfig(model="relevance", batch=16),
        search=_SEARCH,
    )
