"""Reads a model's answer and never guesses: exactly one valid score per test case, or a named fault.

Faults of a whole answer: `empty`, `too-long`, `truncated`, `not-json`, `ambiguous`, `schema`, `wrong-ids`, `duplicate`.
Faults of one test case: `missing`, `not-a-number`, `out-of-range`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Set
from typing import Any, NamedTuple

from saflite.contract.bounds import told
from saflite.contract.score import DULL_BELOW, INTERESTING_ABOVE, SCORE_MAX, SCORE_MIN

ANSWER_CHARS_MAX = 1_000_000
REASON_CHARS_MAX = 500
TIE_WIDTH = 0.4
"""How far apart the ranking puts equal scores, points, and no more than this share of the way to the next other one:
less than half, so it decides between equals alone. Down from the middle on: 7 stays middling, and 10 the most."""
_MIDDLE = (SCORE_MIN + SCORE_MAX) / 2
_FENCE = re.compile(r"```[a-zA-Z]*[ \t]*\r?\n(.*?)```", re.DOTALL)
_THINK, _THOUGHT = re.compile(r"<think(?:ing)?>"), re.compile(r"</think(?:ing)?>")


class Reply(NamedTuple):
    """What a server sent: the answer, and the thoughts some models put it into instead."""

    content: str
    thinking: str = ""


class Line(NamedTuple):
    """The score of one test case, the words that came with it, and how far from it its place puts it."""

    value: float
    reason: str
    beside: float = 0.0

    @property
    def ranked(self) -> float:
        """The score by which test cases are chosen, 0 to 10."""
        return self.value + self.beside


class Parsed(NamedTuple):
    """Each key asked for stands either in `lines` or in `faults`, never in both."""

    lines: dict[str, Line]
    faults: dict[str, str]

    @property
    def fault(self) -> str:
        """The faults in one line, empty if there is none."""
        kinds = sorted(set(self.faults.values()))
        return ", ".join(f"{kind} ({sum(fault == kind for fault in self.faults.values())} ids)" for kind in kinds)


class _Fault(Exception):
    """A fault of the whole answer, by name."""


def parse(reply: Reply, keys: tuple[str, ...]) -> Parsed:
    """Return scores and faults for `keys`; never raises, whatever the answer holds."""
    try:
        document = _document(reply)
        entries = _entries(document, keys)
    except _Fault as whole:
        return Parsed({}, dict.fromkeys(keys, str(whole)))
    lines: dict[str, Line] = {}
    faults: dict[str, str] = {}
    for key in keys:
        if key not in entries:
            faults[key] = "missing"
            continue
        fault = _score_fault(entries[key].get("score"))
        if fault:
            faults[key] = fault
        else:
            lines[key] = Line(float(entries[key]["score"]), _reason(entries[key]))
    return Parsed(_ranked(lines, document.get("ranking")), faults)


# ---- from text to a document --------------------------------------------------------------------------------------


def _document(reply: Reply) -> dict[str, Any]:
    """Return the one JSON object of the answer; raises _Fault."""
    if len(reply.content) > ANSWER_CHARS_MAX or len(reply.thinking) > ANSWER_CHARS_MAX:
        raise _Fault("too-long")
    said, thoughts = _apart(reply.content)
    content, thought = said.strip(), "\n".join([*thoughts, reply.thinking]).strip()
    if not content and not thought:
        raise _Fault("empty")
    return _only_object(content or thought)


def _apart(text: str) -> tuple[str, list[str]]:
    """Return an answer without the thoughts that are marked in it, and those.

    One pattern for both marks would read on to the end from each beginning that has none.
    """
    said, thoughts, at = [], [], 0
    while (begin := _THINK.search(text, at)) and (end := _THOUGHT.search(text, begin.end())):
        said.append(text[at : begin.start()])
        thoughts.append(text[begin.end() : end.start()])
        at = end.end()
    return "".join([*said, text[at:]]), thoughts


def _only_object(text: str) -> dict[str, Any]:
    blocks = [block.strip() for block in _FENCE.findall(text)]
    for candidate in (_whole(text), *(_whole(block) for block in blocks if len(blocks) == 1)):
        if candidate is not None:
            return candidate
    start = text.find("{")
    if start < 0:
        raise _Fault("not-json")
    found, end = _decoded(lambda decoder: decoder.raw_decode(text, start), text)
    if _holds_answer(text[end:]):
        raise _Fault("ambiguous")
    return _object(found)


def _whole(text: str) -> dict[str, Any] | None:
    """Return the object if the text is one JSON object and nothing else, None if it is not whole JSON."""
    if not (text.startswith("{") and text.endswith("}")):
        return None
    try:
        found = _decoded(lambda decoder: (decoder.decode(text), 0), text)[0]
    except _Fault as fault:
        if str(fault) in {"duplicate", "schema"}:
            raise
        return None
    return _object(found)


def _holds_answer(rest: str) -> bool:
    """Return whether there is a second object after the first: two answers are none."""
    return '"test_cases"' in rest or '"score"' in rest


def _object(found: Any) -> dict[str, Any]:
    if not isinstance(found, dict):
        raise _Fault("schema")
    return found


def _decoded(read: Callable[[json.JSONDecoder], tuple[Any, int]], text: str) -> tuple[Any, int]:
    decoder = json.JSONDecoder(object_pairs_hook=_no_doubles, parse_constant=_not_finite)
    try:
        return read(decoder)
    except json.JSONDecodeError as fault:
        raise _Fault("truncated" if fault.pos >= len(text.rstrip()) - 1 else _cut(fault, text)) from fault
    except RecursionError as fault:
        raise _Fault("schema") from fault
    except ValueError as fault:  # an integer of more digits than Python reads
        raise _Fault("schema") from fault


def _cut(fault: json.JSONDecodeError, text: str) -> str:
    """Return `truncated` for a string that never ends, `not-json` for the rest."""
    return "truncated" if fault.msg.startswith("Unterminated string") and "}" not in text[-2:] else "not-json"


def _no_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise _Fault("duplicate")
    return found


def _not_finite(constant: str) -> float:
    return math.nan


# ---- from a document to scores ------------------------------------------------------------------------------------


def _entries(document: dict[str, Any], keys: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    """Return the entries by key; an id that was not asked for or comes twice spoils the answer.

    Both an object by id and a list of objects with an `id` are understood: models used to lists give lists.
    """
    rows = document.get("test_cases")
    if isinstance(rows, dict):
        pairs = list(rows.items())
    elif isinstance(rows, list) and all(isinstance(row, dict) for row in rows):
        pairs = [(row.get("id"), row) for row in rows]
    else:
        raise _Fault("schema")
    entries: dict[str, dict[str, Any]] = {}
    for key, row in pairs:
        if not isinstance(key, str) or key not in keys:
            raise _Fault("wrong-ids")
        if not isinstance(row, dict) or row.get("id", key) != key:
            raise _Fault("schema")
        if key in entries:
            raise _Fault("duplicate")
        entries[key] = row
    return entries


def _ranked(lines: dict[str, Line], ranking: object) -> dict[str, Line]:
    """Return the lines with their place in the model's ranking, the most dangerous first (paper, II-B).

    Models give many test cases of a batch the same whole number. A ranking that does not hold each of them exactly
    once says nothing.
    """
    ranked = [key for key in ranking if isinstance(key, str) and key in lines] if isinstance(ranking, list) else []
    if len(ranked) < 2 or sorted(ranked) != sorted(lines):
        return lines
    values = {line.value for line in lines.values()}
    shares = {key: 1.0 - place / (len(ranked) - 1) for place, key in enumerate(ranked)}
    return {key: line._replace(beside=_beside(line.value, values, shares[key])) for key, line in lines.items()}


def _beside(value: float, values: Set[float], share: float) -> float:
    """Return how far from its score a test case is put, by its share of the way up: in its band, and past no other."""
    if value < _MIDDLE:
        above = min((one for one in (*values, DULL_BELOW) if one > value), default=SCORE_MAX)
        return min(TIE_WIDTH, TIE_WIDTH * (above - value)) * share
    below = max((one for one in (*values, INTERESTING_ABOVE) if one < value), default=SCORE_MIN)
    return min(TIE_WIDTH, TIE_WIDTH * (value - below)) * (share - 1.0)


def _score_fault(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float) or not _finite(value):
        return "not-a-number"
    return "" if SCORE_MIN <= value <= SCORE_MAX else "out-of-range"


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the range of floats
        return False


def _reason(row: dict[str, Any]) -> str:
    words = [row.get(part) for part in ("interpretation", "effect")]
    text = " ".join(word for word in words if isinstance(word, str))
    return told(" ".join(text.split())[:REASON_CHARS_MAX])
