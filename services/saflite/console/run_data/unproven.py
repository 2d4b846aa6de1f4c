"""Violations that were seen and neither confirmed nor refuted: the run stopped before, or nobody could fly them again.

They are no finds, and nothing that was found to hold either: whoever tells a run's result tells of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

from saflite.contract.flight import Purpose
from saflite.contract.verdict import Violation


class JudgedFlight(Protocol):
    """A flight with the policies that it violated."""

    @property
    def test_case(self) -> str:
        """The identity of its test case."""
        ...

    @property
    def purpose(self) -> Purpose:
        """What it was flown for."""
        ...

    @property
    def violated(self) -> tuple[str, ...]:
        """The policies that it violated."""
        ...


class Seen(NamedTuple):
    """A violation as the first flight of a test case shows it."""

    test_case: str
    policy: str


def pending(flights: Iterable[JudgedFlight], violations: Iterable[Violation]) -> tuple[Seen, ...]:
    """Return what first flights violated that is not among the `violations`, which have been decided upon."""
    decided = {(one.test_case, one.policy) for one in violations}
    seen = [Seen(row.test_case, policy) for row in flights if row.purpose == "search" for policy in row.violated]
    return tuple(one for one in seen if one not in decided)


def unproven(flights: Iterable[JudgedFlight], violations: Iterable[Violation]) -> tuple[Seen, ...]:
    """Return what is pending, and what was decided upon without enough re-flights to say."""
    return pending(flights, (one for one in violations if one.confirmation != "unconfirmed"))


def unproven_words(count: int) -> str:
    """Return in words that so many violations are unproven."""
    return f"{count} {'violation' if count == 1 else 'violations'} unconfirmed: neither confirmed nor refuted"
