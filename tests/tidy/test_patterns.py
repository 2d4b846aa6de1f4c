"""No pattern of ours takes time with the square of a text: what it reads may be anybody's, and nothing ends it."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import time
import warnings
from collections.abc import Iterator
from itertools import product

import pytest

import saflite

pytestmark = pytest.mark.live  # it takes times, and ten seconds

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    import sre_parse

CHARS = 20_000
LONGER = 4
SOON_S = 0.02
"""What goes through a text once takes under 0.01 s on one machine; only what takes longer is compared with itself."""
MOST_RATIO = 9.0
"""For a text 4 times as long: what goes through it once takes 4 times as long, the square 16 times."""

WAYS = ("search", "match", "fullmatch", "finditer", "findall", "sub", "split")


def _ways(source: str, name: str) -> set[str]:
    """Return how a pattern is used where it stands; in all ways where that does not show."""
    return {way for way in WAYS if re.search(rf"\b{name}\.{way}\(", source)} or set(WAYS)


def _patterns() -> dict[str, tuple[re.Pattern[str], set[str]]]:
    found = {}
    for info in pkgutil.walk_packages(saflite.__path__, "saflite."):
        if info.name.endswith("__main__") or ".standalone." in info.name:
            continue
        try:
            module = importlib.import_module(info.name)
        except ModuleNotFoundError as lacking:  # an extra that the default tests go without, which collect this too
            if (lacking.name or "").startswith("saflite"):
                raise
            continue
        source = inspect.getsource(module)
        for name, value in vars(module).items():
            if isinstance(value, re.Pattern) and isinstance(value.pattern, str):
                found[f"{info.name}.{name}"] = value, _ways(source, name)
    return found


def _literals(parsed: object) -> Iterator[str]:
    """Yield what a pattern looks for as it stands, and one character of each class."""
    run = ""
    for op, what in parsed:  # type: ignore[attr-defined]
        if op is sre_parse.LITERAL:
            run += chr(what)
            continue
        if run:
            yield run
        run = ""
        if op is sre_parse.IN:
            yield from (
                chr(one if kind is sre_parse.LITERAL else one[0])
                for kind, one in what
                if kind in (sre_parse.LITERAL, sre_parse.RANGE)
            )
        for part in _parts(what):
            yield from _literals(part)
    if run:
        yield run


def _parts(what: object) -> Iterator[object]:
    if isinstance(what, sre_parse.SubPattern):
        yield what
    elif isinstance(what, tuple | list):
        for one in what:
            yield from _parts(one)


def _texts(pattern: re.Pattern[str]) -> Iterator[tuple[str, str]]:
    """Yield texts as what they begin with, and what they go on with."""
    pieces = list(dict.fromkeys([*_literals(sre_parse.parse(pattern.pattern, pattern.flags)), "a", " ", "1"]))
    pieces = pieces[:12]
    yield from (("", piece) for piece in pieces)
    for one, other in product(pieces, pieces):
        if one != other:
            yield one, other
            yield "", one + other


def _took_s(pattern: re.Pattern[str], ways: set[str], text: str) -> float:
    began_s = time.process_time()
    if ways & {"match", "fullmatch"}:
        pattern.match(text), pattern.fullmatch(text)
    if ways - {"match", "fullmatch"}:
        pattern.search(text), pattern.findall(text)
    return time.process_time() - began_s


PATTERNS = _patterns()


@pytest.mark.parametrize("name", sorted(PATTERNS))
def test_no_pattern_goes_back_over_a_text(name: str) -> None:
    pattern, ways = PATTERNS[name]
    for start, piece in _texts(pattern):
        text = start + piece * (CHARS // len(piece))
        if _took_s(pattern, ways, text) < SOON_S:
            continue
        longer = start + piece * (LONGER * CHARS // len(piece))
        ratio = min(_took_s(pattern, ways, longer) for _ in range(3)) / min(
            _took_s(pattern, ways, text) for _ in range(3)
        )
        assert ratio < MOST_RATIO, f"{ratio:.1f} times as long: {pattern.pattern!r} on {text[:60]!r}..."
