"""What it takes to break each policy: violations with the same inputs behind them, told once."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

from saflite.contract.test_case import TestCase, told_in_order
from saflite.contract.verdict import Violation

Inputs = frozenset[tuple[str, str]]
Find = tuple[Violation, TestCase]


class Cause(NamedTuple):
    """The smallest violating test case with certain inputs; `violations` counts the finds that these are behind."""

    policy: str
    test_case: TestCase
    name: str
    violations: int

    @property
    def words(self) -> str:
        """The inputs in words, in the order they are given."""
        return told_in_order(self.test_case.stimuli) or "no input at all"

    def plain(self) -> dict[str, object]:
        """Return it for scripts."""
        return {
            "policy": self.policy,
            "violations": self.violations,
            "test_case": self.name,
            "inputs": [f"{kind} {name}" for kind, name in sorted(_inputs(self.test_case))],
        }


def deduplicate(finds: Iterable[Find], smallest_forms: Collection[str] = ()) -> tuple[Cause, ...]:
    """Return the least sets of inputs (names, not values) among the confirmed violations, most frequent first.

    A violation belongs to the first least set that is part of its inputs. Minimising makes the sets small; without it
    this still joins sequences one of which contains the inputs of the other. Layouts of obstacles have no such order
    and are left out. What is named among `smallest_forms` is counted as the find that it was made of.
    """
    found: dict[str, list[Find]] = {}
    for violation, test_case in finds:
        if violation.confirmation in ("confirmed", "similar") and not test_case.scenario.obstacles:
            found.setdefault(violation.policy, []).append((violation, test_case))
    every = [cause for policy, group in found.items() for cause in _least(policy, group, smallest_forms)]
    return tuple(sorted(every, key=lambda cause: (-cause.violations, cause.policy, cause.name)))


def _least(policy: str, finds: list[Find], smallest_forms: Collection[str]) -> list[Cause]:
    kept: dict[Inputs, list[Find]] = {}
    for find in sorted(finds, key=_size):
        inputs = _inputs(find[1])
        within = next((least for least in kept if least <= inputs), inputs)
        kept.setdefault(within, []).append(find)
    shrunk = _made_of(finds, smallest_forms)
    return [
        Cause(policy, group[0][1], group[0][0].test_case, _count(group, smallest_forms, shrunk))
        for group in kept.values()
    ]


def _count(group: list[Find], smallest_forms: Collection[str], shrunk: Collection[str]) -> int:
    """Return how many finds a group is of: one that was made smaller is counted where its smallest form is, alone."""
    counted_there = {*smallest_forms, *shrunk}
    plain = sum(violation.test_case not in counted_there for violation, _ in group)
    return plain + len(_made_of(group, smallest_forms))


def _made_of(finds: Iterable[Find], smallest_forms: Collection[str]) -> set[str]:
    return {case.origin.parent for violation, case in finds if violation.test_case in smallest_forms}


def _inputs(test_case: TestCase) -> Inputs:
    return frozenset((stimulus.kind, stimulus.name) for stimulus in test_case.stimuli)


def _size(find: Find) -> tuple[int, int, float, str]:
    violation, case = find
    return len(_inputs(case)), len(case.stimuli), case.scenario.time_limit_s, violation.test_case
