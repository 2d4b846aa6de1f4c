"""Every clause of every rule is needed: some example breaks this clause alone, so the rule without it is noticed."""

from __future__ import annotations

import pytest

from saflite.oracle.examples import completed, example_signals
from saflite.oracle.finding import find
from saflite.oracle.formula import Node, clauses, text_of
from saflite.oracle.policy import Policy, load_policy, policy_names, signal_table
from saflite.oracle.stl import Evaluator

TOLD = 100  # characters of either end of a clause: what it is about, and what it asks for


def broken_alone(policy: Policy, parts: list[Node]) -> set[int]:
    """Return which clauses an example breaks that keeps all others."""
    examples, table, alone = policy.file.examples, signal_table(policy.file), set[int]()
    for number in range(1, len(examples) + 1):
        example = completed(examples, number, policy.id)
        if example.holds:
            continue
        signals = example_signals(example, policy.signals, str(number), policy.id, table)
        found = [find(Evaluator(signals, example.step_s), part) for part in parts]
        broken = [at for at, one in enumerate(found) if one is not None and not one.robustness >= 0.0]
        alone |= set(broken) if len(broken) == 1 else set()
    return alone


def told(clause: Node) -> str:
    text = text_of(clause)
    return text if len(text) <= 2 * TOLD else f"{text[:TOLD]} ... {text[-TOLD:]}"


@pytest.mark.parametrize("name", policy_names())
def test_an_example_breaks_each_clause_alone(name: str) -> None:
    policy = load_policy(name)
    parts = clauses(policy.formula)
    alone = broken_alone(policy, parts)
    assert not [f"clause {at}: {told(part)}" for at, part in enumerate(parts) if at not in alone]
