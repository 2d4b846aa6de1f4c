"""Messages made wrong, one place at a time: values of a dictionary, of the same kind or of any, and torn bytes."""

from __future__ import annotations

import unicodedata
from contextlib import suppress
from typing import Any, NamedTuple

import msgspec
import numpy as np

Path = tuple[int | str, ...]

STOP_SHARE = 0.15  # of branches that are changed as a whole
SURROGATE = "\ue000"  # stands for a lone surrogate, which no encoder writes: `encoded` puts its bytes in
INTEGERS: tuple[int, ...] = (0, -1, 1, 2, 2**31, 2**53, 2**53 + 1, 2**63 - 1, 2**63, 2**64 - 1, -(2**63))
FLOATS: tuple[float, ...] = (
    *(0.0, -0.0, 1e-320, 0.5, -1.0, 1e9, 3.4e38, 3.5e38, 1e300, 1.7e308),
    *(float("nan"), float("inf"), float("-inf")),
)
TEXTS: tuple[str, ...] = (
    *("", "w", "0" * 16, "f" * 64, "[/]", "[red]x[/red]", "<script>alert(1)</script>", "'\"><img src=x onerror=y>"),
    *("\x1b]0;x\x07\x1b[2J", "\x9b31m", "\0", "a\nb", "\u202egnp", SURROGATE, f"x{SURROGATE}", "\ufffe", "\U0010ffff"),
    *("../../x", "/etc/passwd", "a/b", "*", "**", "$*", "..", "%s%n", "{0.__class__}", "1e999", "NaN", "-0"),
    *("x" * 64, "x" * 65, "x" * 1_025, "é" * 5_000, "x" * 70_000, "9" * 5_000, "openai:m@http://h/v1", "a," * 300),
)
BYTES: tuple[bytes, ...] = (b"", b"\0", b"\xff\xfe", b"x" * 70_000)


def nested(depth: int) -> list[Any]:
    """Return lists in lists, so deep."""
    found: list[Any] = []
    for _ in range(depth):
        found = [found]
    return found


ODD: tuple[Any, ...] = (None, True, [], {}, nested(300), {"type": "flown"}, {"": ""}, [0] * 200, {"x" * 2_000: 1})
ANY: tuple[Any, ...] = (*INTEGERS, *FLOATS, *TEXTS, *BYTES, *ODD)


class Edit(NamedTuple):
    """A value put in one place of a message."""

    path: Path
    value: Any


class Gone:
    """Stands for a field that is taken away."""


GONE = Gone()


def place_in(value: Any, rng: np.random.Generator) -> Path:
    """Return the path of a place in a message, each branch as likely as its neighbours."""
    path: Path = ()
    while isinstance(value, dict | list | tuple) and value and not (path and rng.random() < STOP_SHARE):
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = keys[int(rng.integers(len(keys)))]
        path, value = (*path, key), value[key]
    return path


def at(value: Any, path: Path) -> Any:
    """Return what stands in a place."""
    for key in path:
        value = value[key]
    return value


def changed(value: Any, edit: Edit) -> Any:
    """Return the message with another value in one place."""
    if not edit.path:
        return edit.value
    copy: Any = dict(value) if isinstance(value, dict) else list(value)
    key, rest = edit.path[0], edit.path[1:]
    if not rest and edit.value is GONE:
        del copy[key]
    else:
        copy[key] = changed(copy[key], Edit(rest, edit.value))
    return copy


def drawn(said: Any, rng: np.random.Generator, most: int = 2) -> tuple[Any, list[Edit]]:
    """Return a message with one to `most` places changed, and the changes."""
    edits: list[Edit] = []
    for _ in range(int(rng.integers(1, most + 1))):
        path = place_in(said, rng)
        edit = Edit(path, _other(at(said, path), rng, whole=not path))
        said = changed(said, edit)
        edits.append(edit)
    return said, edits


def crossed(said: dict[str, Any], other: dict[str, Any], rng: np.random.Generator, most: int = 3) -> dict[str, Any]:
    """Return a message with one to `most` places of another of its kind."""
    for _ in range(int(rng.integers(1, most + 1))):
        path = place_in(said, rng)
        with suppress(KeyError, IndexError, TypeError):  # the other has no such place
            said = changed(said, Edit(path, at(other, path)))
    return said


def _other(value: Any, rng: np.random.Generator, *, whole: bool) -> Any:
    kind = rng.random()
    if kind < 0.1 and not whole:
        return GONE
    if kind < 0.6:
        return _alike(value, rng)
    return ANY[int(rng.integers(len(ANY)))]


def _alike(value: Any, rng: np.random.Generator) -> Any:
    """Return another value of the same type: such changes get past the decoder most often."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return (min(value + 1, 2**64 - 1), max(value - 1, -(2**63)), *INTEGERS)[int(rng.integers(2 + len(INTEGERS)))]
    if isinstance(value, float):
        return (2.0 * value, -value, *FLOATS)[int(rng.integers(2 + len(FLOATS)))]
    if isinstance(value, str):
        return (value + "0", value[:-1], value.upper(), *TEXTS)[int(rng.integers(3 + len(TEXTS)))]
    if isinstance(value, bytes):
        return (_flipped(value, rng), value[: len(value) // 2], *BYTES)[int(rng.integers(2 + len(BYTES)))]
    if isinstance(value, list | tuple):
        rows = list(value)
        return ([], rows[:-1], rows + rows[-1:], rows[::-1], (rows * 200)[:2_000])[int(rng.integers(5))]
    if isinstance(value, dict):
        return ({}, {**value, "another": value}, {**value, "": 0})[int(rng.integers(3))]
    return ANY[int(rng.integers(len(ANY)))]


def encoded(said: Any) -> bytes:
    """Return a message as MessagePack, lone surrogates and all."""
    data = msgspec.msgpack.encode(said)
    return data.replace(SURROGATE.encode(), b"\xed\xa0\x80")


def torn(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes cut off, with a bit flipped, doubled, or nested without end."""
    kind = int(rng.integers(4))
    if kind == 0:
        return data[: int(rng.integers(len(data) + 1))]
    if kind == 1:
        return _flipped(data, rng)
    return data + data if kind == 2 else data[: int(rng.integers(len(data) + 1))] + b"\x91" * 5_000


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return b"\0"
    body = bytearray(data)
    body[int(rng.integers(len(body)))] ^= 1 << int(rng.integers(8))
    return bytes(body)


def steers(text: str) -> bool:
    """Return whether a text holds what could move the cursor, colour, hide, or look like several lines."""
    return any(unicodedata.category(char) in ("Cc", "Cf", "Cs", "Zl", "Zp") for char in text)
