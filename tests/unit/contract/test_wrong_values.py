"""Every value of every message, one after the other, made one that has broken programs: refused, or held and sent."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from saflite.console.io.schema_examples import examples
from saflite.contract import topics, wire
from saflite.contract.bounds import COUNT_MAX
from saflite.contract.errors import Refused

KINDS: dict[str, type[msgspec.Struct]] = {
    kind.__name__: kind for row in topics.TOPICS for kind in (row.message, row.answer) if kind is not None
}
DEEP: list[Any] = []
for _ in range(200):
    DEEP = [DEEP]
NUMBERS = (2**63 - 1, 2**63, 2**64 - 1, -(2**63), -1, math.nan, math.inf, -math.inf, 1e308, 5e-324, -0.0, 2**53 + 1)
TEXTS = (
    *(
        "",
        "\x00",
        "\x1b[2J",
        "\u202eexe",
        "\u2028",
        "\ufffe",
        "../../x",
        "/etc/passwd",
        "a\n",
        "C:\\x",
        "*",
        "saflite/1",
    ),
    *("x" * 70_000, "\U0001f4a9", "\u0130" * 200, "-", ".", "..", "\ufeffx", "=1+1", "<b>", "{{x}}", "%s%n", "$(x)"),
)
OTHERS: tuple[Any, ...] = (None, True, b"\xff", [], {}, [1] * 10, {"type": "unknown"}, {"\x00": 1}, DEEP)
HALVES = (b"\xed\xa0\x80", b"\xff\xfe", b"\xc0\x80")  # no UTF-8: half of a surrogate, a byte order mark, an overlong 0


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list | tuple) else ()
    for name, part in parts:
        yield from places(part, (*path, name))


def changed(value: Any, path: tuple[Any, ...], to: Any) -> Any:
    if not path:
        return to
    if isinstance(value, dict):
        return {**value, path[0]: changed(value[path[0]], path[1:], to)}
    return [changed(part, path[1:], to) if place == path[0] else part for place, part in enumerate(value)]


def held(payload: bytes, kind: type[msgspec.Struct]) -> None:
    """Decode: refused in words that can be written, or a message that can be sent on and shown, the same."""
    try:
        message = wire.decode(payload, kind)
    except Refused as fault:
        str(fault).encode()
        return
    assert wire.decode(wire.encode(message), kind) is not None
    text = msgspec.json.encode(message)
    assert not any(isinstance(one, int) and abs(one) > 2**63 - 1 for one in numbers(json.loads(text)))
    repr(message).encode()


def numbers(value: Any) -> Iterator[Any]:
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from numbers(part)
    else:
        yield value


@pytest.mark.parametrize("name", sorted(KINDS))
def test_every_value_of_a_message_may_be_anything(name: str) -> None:
    kind, tried = KINDS[name], 0
    for example in examples(kind).values():
        whole = msgspec.msgpack.decode(wire.encode(example))
        for path in places(whole):
            for wrong in (*NUMBERS, *TEXTS, *OTHERS):
                held(msgspec.msgpack.encode(changed(whole, path, wrong)), kind)
                tried += 1
    assert tried > 40


@pytest.mark.parametrize("name", sorted(KINDS))
def test_texts_that_are_no_text_are_refused(name: str) -> None:
    kind = KINDS[name]
    mark = "MARK" * 4
    for example in examples(kind).values():
        whole = msgspec.msgpack.decode(wire.encode(example))
        for path in places(whole):
            payload = msgspec.msgpack.encode(changed(whole, path, mark))
            for half in HALVES:
                held(payload.replace(mark.encode(), half.ljust(len(mark), b"a")), kind)


def test_what_is_counted_can_be_added_up() -> None:
    assert COUNT_MAX * 2**9 < 2**63, "sums of a run's counts stay what SQLite holds"
