"""The schemas of files that people write, with what each key means and may be, for editors."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from saflite.contract.config import RANGES, Campaign
from saflite.oracle.policy import ID, PolicyFile

Words = dict[str, dict[str, str]]

_TABLES = {"wind": "Wind", "search": "SearchConfig", "scorer": "ScorerConfig", "lease": "LeaseConfig"}

CAMPAIGN_WORDS: Words = {
    "Campaign": {
        "name": "Name of the campaign: letters, digits, dashes; part of its run folder and its keys on the bus.",
        "description": "What is searched for, in a sentence.",
        "target": "What flies, its settings, and parameters set before take-off.",
        "mission": "Built-in mission (`saflite list missions`) or a .plan file beside this one; or give [start].",
        "start": "Where flights without a mission begin.",
        "wind": "Wind of every flight.",
        "time_limit_s": "Simulated seconds after which a flight ends.",
        "policies": "Rules to break: names (`saflite list policies`) or policy files beside this one.",
        "policy_texts": "Texts of policy files, filled in when a run is made; leave it out.",
        "budget_flights": "First flights, one for each test case; those that confirm and minimise come on top.",
        "rng_seed": "Start of every random draw: two runs with one number find the same.",
        "strategy": "What proposes test cases.",
        "scorer": "What says before flight which test cases are worth flying.",
        "search": "The rhythm of the search, confirming and minimising.",
        "lease": "How long work is lent to workers.",
        "record": "Which flights get a recording.",
        "keep_mb": "Megabytes of traces, artefacts and recordings to keep; later finds leave their digests only.",
        "needs": "What workers of a stage (fly, score, ...) must have.",
    },
    "Needs": {
        "cores": "Cores of the machine a worker runs on, at least.",
        "gpus": "Graphics processors, at least.",
        "labels": "Labels a worker must bear, with their values.",
    },
    "Target": {
        "name": "See `saflite list targets`.",
        "parameters": "Parameters set before take-off, by name.",
        "settings": "Settings of the target (`saflite list settings`), such as planted defects.",
        "build": "Digest of the build that is to fly; empty for any.",
    },
    "StartState": {
        "mode": "Mode in which the flight begins.",
        "altitude_m": "Height above the take-off point, metres.",
        "armed": "Whether it is armed and flying, or on the ground.",
    },
    "Wind": {
        "mean_mps": "Steady wind, m/s.",
        "from_deg": "Compass direction it blows from, degrees.",
        "gust_mps": "Size of gusts, m/s.",
        "gust_period_s": "Time from gust to gust, seconds.",
    },
    "PolicyText": {"text": "Its text.", "file": "Where it was read from."},
    "StrategyConfig": {
        "name": "See `saflite list strategies`.",
        "settings": "Its settings (`saflite list strategies -v`).",
    },
    "ScorerConfig": {
        "model": "See `saflite list scorers`; for example ollama:mistral.",
        "shadow": "Models that score the same without deciding.",
        "guests": "Names of score workers that may run other software; * stands for any text.",
        "batch": "Test cases scored at once.",
        "cascade": "Whether a model on a server is asked only for what it answers while simulators have work.",
        "deadline_s": "Seconds for a batch; then the embedded scorer answers.",
        "load_deadline_s": "Seconds for loading a model.",
    },
    "SearchConfig": {
        "candidates_per_round": "Test cases proposed in a round.",
        "flights_per_round": "Of these, flown.",
        "lag": "Rounds under way at once; a round draws on outcomes of rounds that many before it.",
        "random_share": "Share of flights drawn at random instead of by score.",
        "novelty_weight": "How much being unlike what was flown counts beside the score.",
        "confirm_flights": "Re-flights of a find, each under noise of its own, at most: they end when it is decided.",
        "confirm_needed": "Of these, how many must violate again.",
        "shrink": "Whether finds are made smaller.",
        "shrink_flights_max": "Flights spent at most on making one find smaller.",
        "check_share": "Share of first flights flown over again to see that they repeat bit by bit.",
    },
    "LeaseConfig": {
        "lease_s": "Seconds without a heartbeat after which work is given to another.",
        "heartbeat_s": "Seconds between heartbeats, where no lease needs them sooner and no crowd later.",
        "attempts_max": "Attempts after which a test case is set aside.",
        "wall_limit_s": "Wall-clock seconds after which a flight is given up.",
    },
}

POLICY_WORDS: Words = {
    "PolicyFile": {
        "id": "Name of the policy: small letters, digits, dashes.",
        "title": "The rule in one sentence, as reports show it.",
        "source": "Where the rule comes from: manual, standard, incident.",
        "interestingness": "When a test case is interesting, in words: what scorers that read are told.",
        "formula": "The rule in signal temporal logic: always, eventually, once, lasting[S], implies, ...",
        "terms": "Named parts of the formula; each may use those above it.",
        "signals": "Every signal that is read, with its unit (`saflite list signals`); `flag` or `code` for own ones.",
        "published": "The formula as it was published, where that differs.",
        "constants": "Named numbers of the formula; a unit stands last in the name.",
        "constants_on": "Constants of flights of a target, by its name; logs are judged by `constants`.",
        "state": "Signals shown to scorers as the state of the vehicle.",
        "inputs": "What may be given to break it (`saflite list inputs`).",
        "severity": "When a violation is hard.",
        "points": "Points of the competition by a feature of the flight.",
        "preconditions": "Parameters that must have these values for the rule to be meant.",
        "start": "Where a search begins, if it flies no mission.",
        "procedures": "How it is put to the test, step by step, as a flight tester would (deploy/docs/own-policy.md).",
        "needs_mission": "Whether a search must fly a mission.",
        "twin": "A second flight to compare with: `turned` by a right angle, `idle` (without what does nothing), "
        "or `afresh` (without what came before).",
        "not_checked_on": "Targets it cannot be checked on, with the reason.",
        "deviations": "Where the rule departs from its source, and why.",
        "assumed": "Values of signals that only excuse, for flights that do not hold them.",
        "examples": "Small traces that keep or break the rule; a formula that contradicts them is refused.",
    },
    "Inputs": {
        "published": "Name of the published list of inputs, if it is one.",
        "obstacles": "Whether boxes may be put in the way.",
        "parameters": "Names of parameters.",
        "commands": "Names of MAVLink commands.",
        "sticks": "Names of radio channels.",
        "modes": "Names of modes.",
        "sensor_faults": "Names of sensor faults.",
    },
    "Severity": {
        "hard_at": "Robustness at or below which a violation is hard.",
        "hard_when": "A condition that makes a violation hard, if it is true at some moment.",
    },
    "Points": {
        "feature": "Feature of the flight, such as min_distance_m.",
        "below": "Points are given below this value.",
        "points": "How many.",
    },
    "StartState": CAMPAIGN_WORDS["StartState"],
    "Example": {
        "holds": "Whether the rule must be found kept.",
        "why": "What the example shows.",
        "duration_s": "Length of the trace, seconds.",
        "signals": "A constant, [time, value] points, or {mean, size, period_s, ahead_s} for each signal.",
        "like": "Number of an earlier example, from 1, whose signals are taken over.",
        "step_s": "Time between samples, seconds.",
        "applies": "False where the rule does not apply.",
    },
    "Wave": {
        "mean": "Middle of the swing.",
        "size": "Greatest distance from the middle.",
        "period_s": "Length of a swing, seconds.",
        "ahead_s": "How long before the start it passed its middle upwards, seconds.",
    },
}


def campaign_schema() -> str:
    """Return the JSON Schema of a campaign file as indented text."""
    return _text(Campaign, "Campaign", CAMPAIGN_WORDS, _campaign_ranges())


def policy_schema() -> str:
    """Return the JSON Schema of a policy file as indented text."""
    bounds: dict[tuple[str, str], dict[str, Any]] = {
        ("Example", "duration_s"): {"exclusiveMinimum": 0},
        ("Example", "step_s"): {"exclusiveMinimum": 0},
        ("Example", "like"): {"minimum": 0},
        ("PolicyFile", "id"): {"pattern": f"^{ID.pattern}$"},
    }
    return _text(PolicyFile, "Policy", POLICY_WORDS, bounds)


def _campaign_ranges() -> dict[tuple[str, str], dict[str, Any]]:
    found = {}
    for key, (low, high) in RANGES.items():
        table, _, field = key.rpartition(".")
        found[(_TABLES[table] if table else "Campaign", field)] = {"minimum": low, "maximum": high}
    return found


def _text(kind: type[msgspec.Struct], title: str, words: Words, bounds: dict[tuple[str, str], dict[str, Any]]) -> str:
    (reference,), parts = msgspec.json.schema_components([kind], ref_template="#/$defs/{name}")
    for name, part in parts.items():
        for field, schema in part.get("properties", {}).items():
            schema |= {"description": words.get(name, {}).get(field, ""), **bounds.get((name, field), {})}
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, **reference}
    return json.dumps({**schema, "$defs": dict(sorted(parts.items()))}, indent=1) + "\n"
