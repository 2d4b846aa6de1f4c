"""Wrong messages kept: those that broke something once, and those of the reports on it. Said first by every run.

`tests/corpus/messages.json`: by kind, what is put where in a valid message. What JSON cannot hold is an object with one
of `$float`, `$bytes` (hexadecimal), `$repeat` (text and count), `$nested` (depth), `$gone`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from mutations import GONE, Edit, nested

FILE = Path(__file__).resolve().parents[2] / "tests" / "corpus" / "messages.json"


class Kept(NamedTuple):
    """A wrong message: its kind, what is wrong with it."""

    kind: str
    edits: list[Edit]


def kept() -> Iterator[Kept]:
    """Yield all messages kept."""
    for kind, messages in json.loads(FILE.read_text()).items():
        for edits in messages:
            yield Kept(kind, [Edit(tuple(path), _value(value)) for path, value in edits])


def _value(value: Any) -> Any:
    match value:
        case {"$float": text}:
            return float(text)
        case {"$bytes": text}:
            return bytes.fromhex(text)
        case {"$repeat": [text, count]}:
            return text * count
        case {"$nested": depth}:
            return nested(depth)
        case {"$gone": _}:
            return GONE
        case dict():
            return {key: _value(inner) for key, inner in value.items()}
        case list():
            return [_value(inner) for inner in value]
    return value
