"""A campaign for every policy that inputs can break on a target, and one over all of them at once.

The policy files are read as data (id, title, inputs, start, preconditions): slices do not import each other, and the
oracle's own reader checks the same files fully when a campaign runs.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from saflite.campaign.presets.formula_hints import settings_asked, whole_formula
from saflite.campaign.presets.policy_hints import INPUTS, MODE_COMMAND, can_start, hint_of, modes_of
from saflite.contract.config import Campaign, ScorerConfig, SearchConfig, StrategyConfig
from saflite.contract.errors import Refused
from saflite.contract.outside import parse_toml, read_text
from saflite.contract.plain import some
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET, Setting, StartState, Target
from saflite.contract.work import PolicyText

POLICIES_DIR = Path(__file__).parents[2] / "oracle" / "policies"
PREFIX, ALL = "policy-", "policy-all"
MISSION = "mission2"
EXPOSURE = "exposure"
SHORT_S, MISSION_S, ALL_S = 60.0, 150.0, 300.0
ALL_PHASES = 20  # of a test case for several policies, in five times the time of one for a single policy
MISSION_SHARE = 0.08  # of the flights for rules that hold in missions, too
DRAWN_SHARE = 0.75  # of the flights of the campaign over such a rule: the others fly the campaign's own mission
AIRBORNE_S = 32.0  # with a mission the vehicle leaves the ground after 19.5 s and climbs for 7
MISSION_MODE = "AUTO"
_NAMED = re.compile(r"[A-Z][A-Z0-9_]+")  # an input in a procedure
_SEARCH = SearchConfig(candidates_per_round=24, flights_per_round=12, lag=2, shrink=True)
ALL_RANDOM_SHARE = 0.33  # a scorer passes over the same few rules; their flights are to be flown, too


def policy_campaigns(target: TargetInfo) -> dict[str, Campaign]:
    """Return the generated campaigns for a target by name: those whose signals, inputs and start state it has."""
    made = {name: policy_campaign(name, target) for name in (*(PREFIX + data["id"] for data in _policies()), ALL)}
    return {name: campaign for name, campaign in made.items() if campaign is not None}


def policy_campaign_descriptions(target: TargetInfo) -> dict[str, str]:
    """Return what `policy_campaigns` are for, by name, without what it takes to make them."""
    fit = [data for data in _policies() if not why_not(data, target)]
    every = {ALL: _described_all(len(_different(fit)))} if fit else {}
    return {**{PREFIX + data["id"]: _described(data) for data in fit}, **every}


def policy_campaign(name: str, target: TargetInfo) -> Campaign | None:
    """Return one of the generated campaigns for a target, None if there is none of that name."""
    if name == ALL:
        fit = [data for data in _policies() if not why_not(data, target)]
        return _all(_different(fit), target) if fit else None
    for data in _policies():
        if name == PREFIX + data["id"] and not why_not(data, target):
            return _one(data, target, _known(data, target), _procedures(data, target))
    return None


def why_not(data: dict[str, Any], target: TargetInfo) -> str:
    """Return why there is no campaign over a policy for the target, empty if there is."""
    if target.name in data.get("not_checked_on", {}):
        return str(data["not_checked_on"][target.name])
    if not any(data.get("inputs", {}).get(word) for word in INPUTS):
        return "no inputs named in its file; put it into a campaign file of your own"
    if not any(_known(data, target).values()):
        return f"{target.name} has none of its inputs"
    twin = data.get("twin", "")
    if twin and not target.flies_twin(twin):
        return f"{target.name} flies no twin that is {twin}"
    unseen = target.unseen(data["signals"], twin)
    if unseen:
        return f"{target.name} does not write {', '.join(unseen)}"
    if data.get("needs_mission"):
        return "" if target.missions else f"{target.name} flies no missions"
    mode = data.get("start", {}).get("mode", "")
    if mode and mode not in target.modes:
        return f"{target.name} has no mode {mode} to start in"
    settable = {entry.name for entry in target.inputs if entry.kind in ("parameter", "sensor_fault")}
    unset = sorted(name for name in data.get("preconditions", {}) if name not in settable)
    return f"{target.name} has no parameter {', '.join(unset)}" if unset else ""


def _different(policies: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one policy for each rule: two autopilots' manuals often ask for the same, in two published policies."""
    rules: dict[str, dict[str, Any]] = {}
    for data in policies:
        parts = (data["formula"], *(sorted(data.get(table, {}).items()) for table in ("terms", "constants")))
        rules.setdefault(" ".join(str(parts).replace("\\n", " ").split()), data)
    return list(rules.values())


def pgfuzz_settings(policy: str, target: TargetInfo) -> dict[str, Setting]:
    """Return the settings with which the strategy `pgfuzz` searches a policy that ships, for comparisons."""
    data = next(one for one in _policies() if one["id"] == policy)
    known: dict[str, Setting] = dict(_known(data, target))
    return {**known, "published": data.get("inputs", {}).get("published", "")}


def is_policy(text: str) -> bool:
    """Return whether a TOML text is a policy: it has a formula, or an id and no name as campaigns do."""
    try:
        data = parse_toml(text, "policy file", "")
    except Refused:
        return False
    return "formula" in data or ("id" in data and "name" not in data)


def policy_text(path: Path) -> tuple[str, PolicyText]:
    """Return the id and the text of a policy file; raises Refused if it cannot be read or names no id."""
    text = read_text(path, "policy file")
    name = _read(text, str(path)).get("id")
    if not isinstance(name, str) or not name:
        raise Refused("policy file", where=str(path), expected="an id", got=repr(name))
    return name, PolicyText(file=str(path), text=text)


def campaign_over(path: Path, text: str, target: TargetInfo) -> Campaign:
    """Return the campaign over the policy in a file of one's own, from its inputs, start and preconditions.

    Names stand in it as they do in the file: a policy of one's own is for this target, a wrong name is to be refused.
    """
    name, kept = policy_text(path)
    try:
        data = _read(text, str(path))
        inputs = data.get("inputs", {})
        _check_names(inputs, target, path, text)
        made = _one(data, target, {word: list(inputs.get(word, ())) for word in INPUTS}, _all_procedures(data))
    except (TypeError, ValueError, AttributeError):  # what is wrong is told with its line when the oracle reads it
        made = Campaign(name=PREFIX + name, policies=(name,), start=StartState())
    return msgspec.structs.replace(made, policy_texts={name: kept})


def _check_names(inputs: dict[str, list[str]], target: TargetInfo, path: Path, text: str) -> None:
    """Raise Refused with file, line and key for an input of a policy of one's own that the target does not have."""
    if target.missing:  # said where it is to fly; what it could be given is not known
        return
    for word, kind in INPUTS.items():
        kinds = (kind, "stick") if kind == "command" else (kind,)  # as in PGFuzz's lists
        known = [one.name for one in target.inputs if one.kind in kinds]
        known += ["Flight_Mode"] if kind == "command" else []
        for name in inputs.get(word, ()):
            if name not in known:
                line = text.count("\n", 0, max(text.find(f'"{name}"'), 0)) + 1
                raise Refused(
                    f"policy file, [inputs] {word}",
                    where=f"{path} line {line}",
                    expected=f"an input of {target.name}: {some(known)}",
                    got=repr(name),
                    known=known,
                )


def told(campaign: Campaign, target: TargetInfo) -> Campaign:
    """Return a campaign whose strategy is told what is known of its policies, where it is told nothing yet.

    Policies of one's own are unknown here.
    """
    strategy = campaign.strategy
    if strategy.name != EXPOSURE or "hints" in strategy.settings:
        return campaign
    known = [data for data in _policies() if data["id"] in campaign.policies]
    hints: list[Any] = [hint_of(data, data.get("start", {}), _known(data, target), target) for data in known]
    procedures: list[Any] = [text for data in known for text in _procedures(data, target)]
    settings: dict[str, Setting] = {**strategy.settings, "hints": hints, "procedures": procedures}
    return msgspec.structs.replace(campaign, strategy=msgspec.structs.replace(strategy, settings=settings))


def refuse_unfit(campaign: str, target: TargetInfo) -> None:
    """Raise Refused if it is the campaign of a policy that ships but cannot be broken on the target: say why."""
    for data in _policies():
        if campaign == PREFIX + data["id"]:
            got = why_not(data, target)
            raise Refused(campaign, expected=f"a policy whose inputs can break it on {target.name}", got=got)


def _read(text: str, where: str) -> dict[str, Any]:
    return parse_toml(text, "policy file", where)


@cache
def _policies() -> tuple[dict[str, Any], ...]:
    """Return what stands in the files of the policies that ship."""
    paths = sorted(POLICIES_DIR.glob("*.toml"))
    return tuple(_read(read_text(path, "policy file"), str(path)) for path in paths)


def _known(data: dict[str, Any], target: TargetInfo) -> dict[str, list[Any]]:
    """Return the inputs of a policy that the target has; a policy file serves every target."""
    have = {(entry.kind, entry.name) for entry in target.inputs}
    kinds = {entry.kind for entry in target.inputs}
    inputs = data.get("inputs", {})
    return {
        word: [
            name
            for name in inputs.get(word, ())
            if (kind, name) in have
            or (kind == "command" and ("stick", name) in have)
            or (kind == "command" and name == MODE_COMMAND and "mode" in kinds)
        ]
        for word, kind in INPUTS.items()
    }


def _one(data: dict[str, Any], target: TargetInfo, inputs: dict[str, list[Any]], procedures: list[Any]) -> Campaign:
    start = data.get("start", {})
    settings: dict[str, Setting] = {
        "hints": [hint_of(data, start, inputs, target)],
        "procedures": procedures,
        "others": _others(data, target),
        **_ranges(target),
    }
    needs_mission = data.get("needs_mission", False)
    if needs_mission:
        settings.update(start_s=AIRBORNE_S, missions=DRAWN_SHARE)
    elif target.missions and (not (modes := modes_of(data)) or MISSION_MODE in modes):
        settings["missions"] = MISSION_SHARE
    preconditions = {name: float(value) for name, value in data.get("preconditions", {}).items()}
    return Campaign(
        name=PREFIX + data["id"],
        description=_described(data),
        target=Target(name=target.name, parameters=preconditions),
        mission=MISSION if needs_mission else "",
        start=None if needs_mission else _start(start, target),
        time_limit_s=MISSION_S if needs_mission else SHORT_S,
        policies=(data["id"],),
        budget_flights=300,
        strategy=StrategyConfig(name=EXPOSURE, settings=settings),
        scorer=ScorerConfig(model="relevance", batch=16),
        search=_SEARCH,
    )


def _described(data: dict[str, Any]) -> str:
    return " ".join(f"{data.get('title')}: which inputs break this rule? ({data.get('source')})".split())


def _described_all(rules: int) -> str:
    return f"Any input against {rules} different rules at once, attention rotating over them"


def _procedures(data: dict[str, Any], target: TargetInfo) -> list[Any]:
    """Return the procedures of a policy whose inputs the target has, each told with the policy's name."""
    names = {entry.name for entry in target.inputs}
    return [text for text in _all_procedures(data) if names.issuperset(_NAMED.findall(text))]


def _others(data: dict[str, Any], target: TargetInfo) -> list[Any]:
    """Return the procedures of other rules that enter a mode this one is about: they lead where its own do not.

    But on the target that is there to be broken only of rules that are checked on it: what others give may lie
    outside the ranges that it documents.
    """
    modes, names = set(modes_of(data)), {entry.name for entry in target.inputs}
    return [
        text
        for policy, text, words, named, barred in _every_procedure()
        if policy != data["id"] and modes.intersection(words) and names.issuperset(named)
        if target.name == DEFAULT_TARGET or target.name not in barred
    ]


@cache
def _every_procedure() -> tuple[tuple[str, str, frozenset[str], frozenset[str], frozenset[str]], ...]:
    """Return id and text of each procedure that ships, its words and inputs, and where its rule is not checked."""
    return tuple(
        (
            data["id"],
            text,
            frozenset(re.split(r"[\s;|?]+", text)),
            frozenset(_NAMED.findall(text)),
            frozenset(data.get("not_checked_on", {})),
        )
        for data in _policies()
        for text in _all_procedures(data)
    )


def _all_procedures(data: dict[str, Any]) -> list[Any]:
    return [f"{data['id']} {' '.join(str(text).split())}" for text in data.get("procedures", ())]


def _ranges(target: TargetInfo) -> dict[str, Setting]:
    """Return what keeps values within documented ranges, but on the target that is there to be broken: makers of
    autopilots refuse findings that need others."""
    return {} if target.name == DEFAULT_TARGET else {"beyond": 0.0}


def _start(start: dict[str, Any], target: TargetInfo) -> StartState:
    """Return the start state a policy asks for, or the target's usual one where it asks for none or cannot begin so."""
    if can_start(start, target) or not target.start_states:
        return StartState(**start)
    return target.start_states[0]


def _all(policies: list[dict[str, Any]], target: TargetInfo) -> Campaign:
    """Return the campaign that looks for whatever breaks any rule; inputs come from all the target has.

    What a rule asks of a setting in its formula or its procedures give is no precondition of all: it is given where the
    rule is meant.
    """
    preconditions = {
        name: float(value)
        for data in policies
        for name, value in sorted(data.get("preconditions", {}).items())
        if not any(entry.name == name for entry, _ in settings_asked(whole_formula(data), target))
        and not any(name in text.split() for text in _procedures(data, target))
    }
    loiter = {"mode": "LOITER", "altitude_m": 30.0} if "LOITER" in target.modes else {}
    hints: list[Any] = [hint_of(data, data.get("start", {}), _known(data, target), target) for data in policies]
    procedures: list[Any] = [text for data in policies for text in _procedures(data, target)]
    missions = MISSION_SHARE if any(data.get("needs_mission") for data in policies) else 0.0
    return Campaign(
        name=ALL,
        description=_described_all(len(policies)),
        target=Target(name=target.name, parameters=preconditions),
        start=_start(loiter, target),
        time_limit_s=ALL_S,
        policies=tuple(data["id"] for data in policies),
        budget_flights=2000,
        strategy=StrategyConfig(
            name=EXPOSURE,
            settings={
                "hints": hints,
                "procedures": procedures,
                "missions": missions,
                "phases_max": ALL_PHASES,
                **_ranges(target),
            },
        ),
        scorer=ScorerConfig(model="relevance", batch=16),
        search=msgspec.structs.replace(_SEARCH, random_share=ALL_RANDOM_SHARE),
    )
