"""What a policy's formula is made of: one kind of node, terms (numbers over time) below, truth values above.

Terms: number, signal, `+ - * /`, neg, abs, sqrt, exp, pow, min, max; over time: before, rate, ago, mean, latch; turn
brings an angle to -180..180, sin and cos take degrees. Comparisons: `<= < >= > == !=`, each also in a crisp form
(`is<=` ...). Above them: not, and, or, implies, iff, xor; over time: always, eventually, until, historically, once,
since, rise, fall, prev, next, and lasting: true once something has been true for a time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import NamedTuple

COMPARISONS = ("<=", "<", ">=", ">", "==", "!=")
TEMPORAL = ("always", "eventually", "until", "historically", "once", "since", "lasting")
FUTURE = ("always", "eventually", "until")
LOGIC = ("not", "and", "or", "implies", "iff", "xor", "rise", "fall", "prev", "next")
CRISP = "is"


class Node(NamedTuple):
    """One node. `low_s` and `high_s` bound a temporal operator; `value` is a number's or a time of a term (seconds)."""

    op: str
    args: tuple[Node, ...] = ()
    low_s: float = 0.0
    high_s: float = math.inf
    value: float = 0.0
    name: str = ""


def number(value: float) -> Node:
    """Return a constant term."""
    return Node("number", value=value)


_ONE: dict[tuple[object, ...], Node] = {}


def interned(node: Node) -> Node:
    """Return the one node of this process that is made like this one, so that what formulas share is found by place."""
    args = tuple(interned(child) for child in node.args)
    key = (node.op, tuple(map(id, args)), node.low_s, node.high_s, node.value, node.name)
    if key not in _ONE:
        _ONE[key] = node._replace(args=args)
    return _ONE[key]


def is_truth(node: Node) -> bool:
    """Say whether the node has a truth value (and a robustness), rather than being a term."""
    return node.op in COMPARISONS or node.op in TEMPORAL or node.op in LOGIC or node.op.startswith(CRISP)


def walk(node: Node) -> Iterator[Node]:
    """Yield the node and all below it."""
    yield node
    for child in node.args:
        yield from walk(child)


def clauses(formula: Node) -> list[Node]:
    """Return the formulas that must all hold: what `and` joins, at the top or below an `always`."""
    if formula.op == "and":
        return [clause for part in formula.args for clause in clauses(part)]
    if formula.op == "always":
        return [formula._replace(args=(clause,)) for clause in clauses(formula.args[0])]
    return [formula]


def signals_of(node: Node) -> frozenset[str]:
    """Return the names of the signals the formula reads."""
    return frozenset(part.name for part in walk(node) if part.op == "signal")


@cache
def reach_s(node: Node) -> float:
    """Return how far into the future the node looks, in seconds; infinite where a window has no end."""
    below = max((reach_s(child) for child in node.args), default=0.0)
    return below + (node.high_s if node.op in FUTURE else 0.0)


def harden(node: Node, where: Callable[[Node], bool]) -> Node:
    """Return the formula with those comparisons made crisp for which `where` holds.

    A crisp comparison is worth plus or minus infinity, so that it decides whether a rule applies and never how well it
    is kept. `iff` and `xor` above crisp comparisons are rewritten into implications, as infinities have no difference.
    """
    if node.op in COMPARISONS:
        return node._replace(op=CRISP + node.op) if where(node) else node
    args = tuple(harden(child, where) for child in node.args)
    if node.op == "iff" and args != node.args:
        return Node("and", (Node("implies", args), Node("implies", args[::-1])))
    if node.op == "xor" and args != node.args:
        left, right = args
        return Node("or", (Node("and", (left, Node("not", (right,)))), Node("and", (Node("not", (left,)), right))))
    return node._replace(args=args)


def text_of(node: Node) -> str:
    """Return the formula as text that parses to the same tree; every operator in brackets, times in seconds."""
    parts = [text_of(child) for child in node.args]
    if node.op == "number":
        return repr(node.value) if node.value >= 0 else f"(-{-node.value!r})"
    if node.op == "signal":
        return node.name
    if node.op in ("not", "neg"):
        return f"({'not' if node.op == 'not' else '-'} {parts[0]})"
    window = "" if math.isinf(node.high_s) else f"[{node.low_s!r}:{node.high_s!r}]"
    if node.op == "lasting":
        return f"(lasting[{node.high_s!r}] {parts[0]})"
    if node.op in TEMPORAL:
        return f"({parts[0]} {node.op}{window} {parts[1]})" if len(parts) > 1 else f"({node.op}{window} {parts[0]})"
    if node.op == "before":
        return f"prev({parts[0]})"
    if len(parts) == 2 and node.op not in ("min", "max", "pow", "latch"):
        return f"({parts[0]} {node.op.removeprefix(CRISP)} {parts[1]})"
    times = [repr(node.value)] if node.op in ("ago", "mean") else []
    return f"{node.op}({', '.join(parts + times)})"
