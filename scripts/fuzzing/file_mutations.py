"""Files made wrong: in their data where they are text, in their words, and in their bytes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import numpy as np
import tomli_w
import yaml
from mutations import GONE, INTEGERS, SURROGATE, drawn, torn

Language = Literal["json", "toml", "yaml", "words", "bytes"]

WORD = re.compile(r"[A-Za-z_][\w.-]*|[+-]?\d[\d.eE+-]*|\s+|.", re.DOTALL)
WORDS: tuple[str, ...] = (
    *(
        "",
        "0",
        "-0",
        "-1",
        "1e999",
        "-1e999",
        "1e308",
        "1e-320",
        "nan",
        "inf",
        "NaN",
        "Infinity",
        "9" * 400,
        "9" * 5_000,
    ),
    *("0x10", "0b1", "1_000", "1.", ".5", "1e", "--1", "true", "null", "~", "None", "2026-01-01", "12:30:45"),
    *("[", "]", "{", "}", "(", ")", '"', "'", '"""', "'''", ",", ":", "=", "#", "\\", "\\u0000", "\\ud800", "\\x1b"),
    *("\n", "\r", "\t", "\0", "\x1b[2J", "\u202e", "\ufeff", "\u2028", "\U0010ffff", "é" * 3_000, "x" * 70_000),
    *("&a", "*a", "!!python/object/apply:os.system", "!!binary", "!!set", "<<", "---", "...", "? ", "| ", "> "),
    *("../../x", "/etc/passwd", "/dev/zero", "a/b", "%s", "{0}", "always", "and", "not", "until", "prev(", "latch("),
    *("(" * 300, "[" * 300, "[" * 100_000, "not " * 500, "1 and " * 500, "a." * 300, "- " * 2_000, "\n" * 5_000),
)
EDGES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 2**63 - 1, 2**64 - 1)


def wrong(data: bytes, language: Language, rng: np.random.Generator) -> bytes:
    """Return the content of a file made wrong in one of the ways its language allows."""
    if language == "bytes":
        return in_bytes(data, rng)
    kind = rng.random()
    if kind < 0.1:
        return torn(data, rng)
    if kind < 0.5 or language == "words":
        return in_words(data.decode("utf-8", "replace"), rng).encode("utf-8", "surrogatepass")
    return in_data(data, language, rng)


def in_data(data: bytes, language: Language, rng: np.random.Generator) -> bytes:
    """Return a text with one or two values of the data it stands for changed; as it was where none can be written."""
    write = _LANGUAGES[language][1]
    said = drawn(_read(data, language), rng)[0]
    try:
        return write(_plain(said)).replace(SURROGATE, "\\ud800").encode("utf-8", "surrogatepass")
    except (ValueError, TypeError, RecursionError, OverflowError, yaml.YAMLError):
        return data


@cache
def _read(data: bytes, language: Language) -> Any:
    """Return the data of a valid file; changes are made to copies."""
    return _LANGUAGES[language][0](data.decode())


def in_words(text: str, rng: np.random.Generator) -> str:
    """Return a text with one to three of its words replaced, taken out, doubled, or moved."""
    words = WORD.findall(text) or [""]
    for _ in range(int(rng.integers(1, 4))):
        place = int(rng.integers(len(words)))
        kind = int(rng.integers(5))
        if kind == 0:
            words[place] = ""
        elif kind == 1:
            words[place] += words[place]
        elif kind == 2:
            words[place] = words[int(rng.integers(len(words)))]
        else:
            words[place] = WORDS[int(rng.integers(len(WORDS)))]
    return "".join(words)


def in_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Return bytes with one to eight stretches flipped, overwritten, cut, doubled or put elsewhere."""
    body = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        _IN_BYTES[int(rng.integers(len(_IN_BYTES)))](body, rng)
    return bytes(body)


def _flip(body: bytearray, rng: np.random.Generator) -> None:
    if body:
        body[int(rng.integers(len(body)))] ^= 1 << int(rng.integers(8))


def _edge(body: bytearray, rng: np.random.Generator) -> None:
    size = (1, 2, 4, 8)[int(rng.integers(4))]
    if len(body) >= size:
        place = int(rng.integers(len(body) - size + 1))
        value = EDGES[int(rng.integers(len(EDGES)))] % (1 << 8 * size)
        body[place : place + size] = value.to_bytes(size, "little" if rng.random() < 0.5 else "big")


def _cut(body: bytearray, rng: np.random.Generator) -> None:
    if rng.random() < 0.2:
        del body[int(rng.integers(len(body) + 1)) :]


def _gone(body: bytearray, rng: np.random.Generator) -> None:
    place = int(rng.integers(len(body) + 1))
    del body[place : place + int(rng.integers(1, 65))]


def _doubled(body: bytearray, rng: np.random.Generator) -> None:
    place, other = (int(rng.integers(len(body) + 1)) for _ in range(2))
    body[other:other] = body[place : place + int(rng.integers(1, 257))]


Change = Callable[[bytearray, np.random.Generator], None]
_IN_BYTES: tuple[Change, ...] = (
    _flip,
    _flip,
    _edge,
    _edge,
    _cut,
    _gone,
    _doubled,
)


def _plain(value: Any) -> Any:
    """Return data that the writers of all languages take, or say that they do not."""
    if isinstance(value, dict):
        return {str(key): _plain(part) for key, part in value.items() if part is not GONE}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value if part is not GONE]
    return value.decode("latin-1") if isinstance(value, bytes) else value


def _without_none(value: Any) -> Any:
    """Return data as TOML can hold it, which has no null."""
    if isinstance(value, dict):
        return {key: _without_none(part) for key, part in value.items() if part is not None}
    return [_without_none(part) for part in value if part is not None] if isinstance(value, list) else value


def _toml(said: Any) -> str:
    return tomli_w.dumps(_without_none(said) if isinstance(said, dict) else {"x": INTEGERS[0]})


def _read_toml(text: str) -> Any:
    import tomllib

    return tomllib.loads(text)


_YAML: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # ten times as fast, where there is one

_LANGUAGES: dict[str, tuple[Callable[[str], Any], Callable[[Any], str]]] = {
    "json": (json.loads, json.dumps),
    "toml": (_read_toml, _toml),
    "yaml": (yaml.safe_load, lambda said: str(yaml.dump(said, Dumper=_YAML, sort_keys=False))),
}
