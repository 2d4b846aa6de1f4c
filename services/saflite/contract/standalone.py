"""What a target is told of a finding that it makes a script of: one that reproduces it without the farm.

A target that can do so offers `standalone(test_case, flight, evidence)` beside what `contract/target.py` names: it
returns files by name, the one to run first.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from saflite.contract.flight import Flight
from saflite.contract.test_case import TestCase


class Evidence(NamedTuple):
    """What people are told: the file's name, the rule broken and when, what maintainers ask first, the steps.

    The run may be anybody's: texts are `plain`, for they come to stand in programs.
    """

    file: str
    policy: str
    title: str
    from_s: float
    until_s: float
    asked: Mapping[str, str]
    steps: Sequence[str]


Files = dict[str, str]
"""Texts by file name; the first is the program that flies the finding, the others are parts of it for other tools."""
Standalone = Callable[[TestCase, Flight, Evidence], Files]
"""The flight is the recorded one, which must be met bit by bit. Raises Refused where it is not, or Unavailable."""


def filled(template: str, contents: Mapping[str, str]) -> str:
    """Return a template with what belongs there at its places, each taken once: a content that names one is text."""
    places = "|".join(map(re.escape, contents))
    left = dict(contents)
    return re.sub(places, lambda found: left.pop(found[0], found[0]), template)


def as_docstring(words: str) -> str:
    """Return a text as it may stand between three quotes in Python."""
    return words.replace("\\", "/").replace('"""', "'''")
