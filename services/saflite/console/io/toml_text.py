"""A campaign as TOML text that `saflite run` reads again."""

from __future__ import annotations

import json
from typing import Any

import msgspec

from saflite.contract.config import Campaign


def dump(campaign: Campaign) -> str:
    """Return the campaign file; what is None or an empty table is left out."""
    lines: list[str] = []
    _table("", msgspec.to_builtins(campaign), lines)
    return "\n".join(lines) + "\n"


def _table(name: str, values: dict[str, Any], lines: list[str]) -> None:
    plain = {key: value for key, value in values.items() if value is not None and not isinstance(value, dict)}
    if name and plain:
        lines += ["", f"[{name}]"]
    lines += [f"{_key(key)} = {_value(value)}" for key, value in plain.items()]
    for key, value in values.items():
        if isinstance(value, dict) and value:
            _table(f"{name}.{_key(key)}" if name else _key(key), value, lines)


def _key(key: str) -> str:
    bare = key and all(char.isascii() and (char.isalnum() or char in "-_") for char in key)
    return key if bare else json.dumps(key)


def _value(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
