"""What a target is told of a finding that it makes a script of: one that reproduces it without the farm.

A target that can do so offers `standalone(test_case, flight, evidence)` beside what `contract/target.py` names: it
returns files by name, the one to run first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from saflite.contract.flight import Flight
from saflite.contract.test_case import TestCase


class Evidence(NamedTuple):
    """What people are told: the file's name, the rule broken and when, what maintainers ask first, the steps."""

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
