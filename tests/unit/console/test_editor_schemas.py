"""Schemas for editors: every key with its meaning and range, and they accept and refuse what the code does."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from saflite.campaign.presets.campaigns import BUILTIN_DIR
from saflite.console.io import editor_schemas
from saflite.console.operations import beginning
from saflite.contract.config import RANGES, parse_campaign
from saflite.contract.errors import Refused
from saflite.contract.gaps import gaps
from saflite.oracle.policy import POLICIES_DIR, PolicyFile, parse_policy

CAMPAIGN, POLICY = json.loads(editor_schemas.campaign_schema()), json.loads(editor_schemas.policy_schema())


def faults(schema: dict[str, Any], data: object) -> list[str]:
    return [fault.message for fault in jsonschema.Draft202012Validator(schema).iter_errors(data)]


@pytest.mark.parametrize("schema", [CAMPAIGN, POLICY], ids=["campaign", "policy"])
def test_every_key_says_what_it_means(schema: dict[str, Any]) -> None:
    silent = [
        f"{name}.{field}"
        for name, part in schema["$defs"].items()
        for field, entry in part["properties"].items()
        if len(entry.get("description", "")) < 8
    ]
    assert silent == []


@pytest.mark.parametrize("path", sorted(POLICIES_DIR.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_policies_fit(path: Path) -> None:
    assert faults(POLICY, tomllib.loads(path.read_text())) == []


@pytest.mark.parametrize("path", sorted(BUILTIN_DIR.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_campaigns_fit(path: Path) -> None:
    assert faults(CAMPAIGN, tomllib.loads(path.read_text())) == []


@pytest.mark.parametrize("key", sorted(RANGES))
def test_numbers_out_of_range_are_refused_by_both(key: str) -> None:
    table, _, field = key.rpartition(".")
    text = f'name = "x"\nmission = "m2"\n[{table}]\n{field} = -1e30' if table else f'name = "x"\n{field} = -10000000000'
    if key == "rng_seed":
        text = f'name = "x"\nrng_seed = {-(2**63) - 1}'
    assert faults(CAMPAIGN, tomllib.loads(text))
    with pytest.raises(Refused):
        parse_campaign(text, "x.toml")


def test_all_that_is_missing_is_told_at_once() -> None:
    with pytest.raises(Refused) as caught:
        parse_policy('id = "x"\ntitel = "y"\n[[examples]]\nholds = true\n', "x.toml")
    for word in ("`title`", "`source`", "`formula`", "`signals`", "`titel` is unknown", "`examples[0].why`"):
        assert word in str(caught.value)
    with pytest.raises(Refused) as caught:
        parse_campaign("budget_flight = 3\n[search]\nlags = 2\n", "x.toml")
    for word in ("`name` is missing", "(`budget_flights`?)", "`search.lags` is unknown (`lag`?)"):
        assert word in str(caught.value)


def test_whole_files_have_no_gaps() -> None:
    text = beginning.text_of("policy.toml", "mine")
    assert gaps(tomllib.loads(text), PolicyFile) == []
    assert faults(POLICY, tomllib.loads(text)) == []
    assert faults(CAMPAIGN, tomllib.loads(beginning.text_of("campaign.toml", "mine"))) == []
