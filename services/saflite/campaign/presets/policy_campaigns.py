"""A campaign for every policy that inputs can break on the reference target, and one over all of them at once.

The policy files are read as data (id, title, inputs, start, preconditions): slices do not import each other, and the
oracle's own reader checks the same files fully when a campaign runs.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from saflite.contract.config import Campaign, ScorerConfig, SearchConfig, StrategyConfig, read_text
from saflite.contract.errors import Refused
from saflite.contract.test_case import Setting, StartState, Target
from saflite.contract.work import PolicyText
from saflite.flight.autopilots.reference.parameters import parameter_table

POLICIES_DIR = Path(__file__).parents[2] / "oracle" / "policies"
PREFIX, ALL = "policy-", "policy-all"
TARGET = "reference"
MISSION = "mission2"
SHORT_S, MISSION_S = 60.0, 150.0
AIRBORNE_S = 32.0  # with a mission the vehicle leaves the ground after 19.5 s and climbs for 7
_INPUTS = ("parameters", "commands", "sticks", "modes", "sensor_faults")
_SEARCH = SearchConfig(candidates_per_round=96, flights_per_round=16, shrink=True)


def policy_campaigns() -> dict[str, Campaign]:
    """Return the generated campaigns by name."""
    single = {name: _one(data, _known) for name, data in _policies().items()}
    return {**single, ALL: _all([data for data in _policies().values() if not data.get("needs_mission")])}


def is_policy(text: str) -> bool:
    """Return whether a TOML text is a policy: it has a formula."""
    try:
        return "formula" in tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return False


def policy_text(path: Path) -> tuple[str, PolicyText]:
    """Return the id and the text of a policy file; raises Refused if it cannot be read or names no id."""
    text = read_text(path, "policy file")
    name = _read(text, str(path)).get("id")
    if not isinstance(name, str) or not name:
        raise Refused("policy file", where=str(path), expected="an id", got=repr(name))
    return name, PolicyText(file=str(path), text=text)


def campaign_over(path: Path, text: str) -> Campaign:
    """Return the campaign over the policy in a file of one's own, from its inputs, start and preconditions."""
    name, kept = policy_text(path)
    try:
        made = _one(_read(text, str(path)), _listed)
    except (TypeError, ValueError, AttributeError):  # what is wrong is told with its line when the oracle reads it
        made = Campaign(name=PREFIX + name, policies=(name,), start=StartState())
    return msgspec.structs.replace(made, policy_texts={name: kept})


def refuse_unchecked(campaign: str) -> None:
    """Raise Refused if it is the campaign of a policy that ships but cannot be broken on the reference: say why."""
    path = POLICIES_DIR / f"{campaign.removeprefix(PREFIX)}.toml"
    if campaign.startswith(PREFIX) and Path(campaign).name == campaign and path.is_file():
        why = _read(read_text(path, "policy file"), path.name).get("not_checked_on", {}).get(TARGET)
        got = why or "no inputs named in its file; put it into a campaign file of your own"
        raise Refused(campaign, expected=f"a policy whose inputs can break it on {TARGET}", got=got)


def _read(text: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as fault:
        raise Refused("policy file", where=where, expected="TOML", got=str(fault)) from fault


@cache
def _policies() -> dict[str, dict[str, Any]]:
    """Return what stands in the files of the policies that stimuli can break on the reference target, by campaign."""
    found = {}
    for path in sorted(POLICIES_DIR.glob("*.toml")):
        data = _read(read_text(path, "policy file"), str(path))
        inputs = data.get("inputs", {})
        if TARGET not in data.get("not_checked_on", {}) and any(inputs.get(word) for word in _INPUTS):
            found[PREFIX + data["id"]] = data
    return found


def _one(data: dict[str, Any], known: Callable[[str, list[str]], list[Any]]) -> Campaign:
    inputs = data.get("inputs", {})
    settings: dict[str, Setting] = {word: known(word, inputs.get(word, ())) for word in _INPUTS}
    settings["published"] = inputs.get("published", "")
    needs_mission = data.get("needs_mission", False)
    if needs_mission:
        settings["start_s"] = AIRBORNE_S
    start = data.get("start", {})
    return Campaign(
        name=PREFIX + data["id"],
        description=f"{data.get('title')}: which inputs break this rule? ({data.get('source')})",
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


def _listed(word: str, names: list[str]) -> list[float | int | str | bool]:
    """Return the names as they stand: a policy of one's own is for this target, and a wrong name is to be refused."""
    return list(names)


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
