"""`schemas/` says what the code says, every golden message ever committed still decodes, and others can read them."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import msgpack
import msgspec
import pytest

from saflite.console.io import schema_examples, schemas
from saflite.contract import wire
from saflite.contract.config import Campaign, parse_campaign
from saflite.contract.errors import Refused

FOLDER = Path(__file__).resolve().parents[3] / "schemas"
KINDS = {**schemas.messages(), "campaign": schemas.CAMPAIGN}


def test_committed_schemas_do_not_drift() -> None:
    assert schemas.drift(FOLDER) == [], "run scripts/schemas"


@pytest.mark.parametrize("path", sorted((FOLDER / "wire").glob("*.msgpack")), ids=lambda path: path.stem)
def test_every_golden_message_still_decodes(path: Path) -> None:
    kind = KINDS[path.stem.split(".")[0].split("-")[0]]
    assert isinstance(wire.decode(path.read_bytes(), kind), kind)


@pytest.mark.parametrize("stem", sorted(schemas.goldens()))
def test_an_independent_reader_sees_the_same_message(stem: str) -> None:
    data = schemas.goldens()[stem]
    kind = KINDS[stem.split("-")[0]]
    read = msgpack.unpackb(data, strict_map_key=False)
    ours = msgspec.to_builtins(wire.decode(data, kind), builtin_types=(bytes,))
    assert read == json_like(ours)


def json_like(value: object) -> object:
    if isinstance(value, dict):
        return {key: json_like(item) for key, item in value.items()}
    return [json_like(item) for item in value] if isinstance(value, list | tuple) else value


@pytest.mark.parametrize("name", sorted(KINDS))
def test_examples_fit_their_schema(name: str) -> None:
    schema = json.loads(schemas.schema_text(KINDS[name]))
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    for example in schema_examples.examples(KINDS[name]).values():
        validator.validate(json.loads(msgspec.json.encode(example)))


def test_the_schema_refuses_what_the_code_refuses() -> None:
    validator = jsonschema.Draft202012Validator(json.loads(schemas.schema_text(Campaign)))
    bad = {"name": "x", "budget_flight": 3}
    assert list(validator.iter_errors(bad))
    with pytest.raises(Refused, match="budget_flight"):
        parse_campaign('name = "x"\nbudget_flight = 3', "x.toml")


def test_every_variant_of_a_union_has_a_golden_message() -> None:
    stems = schemas.goldens()
    assert {"Grant-fly", "Grant-score", "Report-judged", "Event-violation", "Event-fault"} <= set(stems)
