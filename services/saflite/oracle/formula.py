"""What a policy's formula is made of: one kind of node, terms (numbers over time) below, truth values above.

Terms: number, signal, `+ - * /`, neg, abs, sqrt, exp, pow, min, max; over time: before, rate, ago, mean, latch; turn
brings an angle to -180..180, sin and cos take degrees. Comparisons: `<= < >= > == !=`, each also in a crisp form
(`is<=` ...). Above them: not, and, or, implies, iff, xor; over time: always, eventually, until, historically, once,
since, rise, fall, prev, next, and lasting: true once something has been true for a time.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import NamedTuple

COMPARISONS = ("<=", "<", ">=", ">", "==", "!=")
TEMPORAL = ("always", "eventually", "until", "historically", "once", "since", "lasting")
FUTURE = ("always", "eventually", "until")
LOGIC = ("not", "and", "or", "implies", "iff", "xor", "rise", "fall", "prev", "next")
CRISP = "is"
TOGETHER = ("and", "lasting", "prev")  # what a condition is made of, all of it true at once
_CONDITION_AT = {"implies": 0, "latch": 1}


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


def parts(node: Node) -> list[Node]:
    """Return the node and all below it, each once and below those it is an argument of.

    What formulas share is one node named in several places: with all named parts written out they are hundreds of
    times as long. Iterative, as a text may join more parts than the stack holds.
    """
    known: set[int] = set()
    found: list[Node] = []
    left = [node]
    while left:
        waiting = [child for child in left[-1].args if id(child) not in known]
        if waiting:
            left += waiting
            continue
        last = left.pop()
        if id(last) not in known:
            known.add(id(last))
            found.append(last)
    return found


KEPT_MAX = 100_000  # the shipped policies have 7,000; texts that came with work are without number
_ONE: dict[tuple[object, ...], Node] = {}


def interned(node: Node) -> Node:
    """Return the one node of this process that is made like this one, so that what formulas share is found by place."""
    if len(_ONE) > KEPT_MAX:
        _ONE.clear()  # what is made from now on is shared anew
    made: dict[int, Node] = {}
    for part in parts(node):
        args = tuple(made[id(child)] for child in part.args)
        key = (part.op, tuple(map(id, args)), part.low_s, part.high_s, part.value, part.name)
        made[id(part)] = _ONE.setdefault(key, part._replace(args=args))
    return made[id(node)]


def is_truth(node: Node) -> bool:
    """Say whether the node has a truth value (and a robustness), rather than being a term."""
    return node.op in COMPARISONS or node.op in TEMPORAL or node.op in LOGIC or node.op.startswith(CRISP)


def clauses(formula: Node) -> list[Node]:
    """Return the formulas that must all hold: what `and` joins, at the top or below an `always`."""
    if formula.op == "and":
        return [clause for part in formula.args for clause in clauses(part)]
    if formula.op == "always":
        return [formula._replace(args=(clause,)) for clause in clauses(formula.args[0])]
    return [formula]


def signals_of(node: Node) -> frozenset[str]:
    """Return the names of the signals the formula reads."""
    return frozenset(part.name for part in parts(node) if part.op == "signal")


_REACH: dict[int, tuple[Node, float]] = {}  # by place; the node is held, so that no other takes it


def reach_s(node: Node) -> float:
    """Return how far into the future the node looks, in seconds; infinite where a window has no end."""
    known = _REACH.get(id(node))
    if known is not None:
        return known[1]
    reach: dict[int, float] = {}
    for part in parts(node):
        below = max((reach[id(child)] for child in part.args), default=0.0)
        reach[id(part)] = below + (part.high_s if part.op in FUTURE else 0.0)
    if len(_REACH) > KEPT_MAX:
        _REACH.clear()
    _REACH[id(node)] = (node, reach[id(node)])
    return reach[id(node)]


def harden(formula: Node, where: Callable[[Node], bool]) -> Node:
    """Return the formula with conditions (of `implies`, `latch`) crisp, and those comparisons for which `where` holds.

    A crisp comparison is worth plus or minus infinity, so that it decides whether a rule applies and never how well it
    is kept. `iff` and `xor` above crisp comparisons are rewritten into implications, as infinities have no difference.
    """
    made: dict[tuple[int, bool], Node] = {}  # by place, and whether all comparisons there are crisp

    def visit(node: Node, crisp: bool) -> Node:
        if (id(node), crisp) not in made:
            made[id(node), crisp] = visited(node, crisp)
        return made[id(node), crisp]

    def visited(node: Node, crisp: bool) -> Node:
        conditions = [crisp] * len(node.args)
        if node.op in _CONDITION_AT:
            conditions[_CONDITION_AT[node.op]] = True
        args = tuple(map(visit, node.args, conditions))
        if node.op in COMPARISONS and (crisp or where(node)):
            return node._replace(op=CRISP + node.op, args=args)
        return node if all(map(operator.is_, args, node.args)) else _rebuilt(node, args)

    return visit(formula, False)


def _rebuilt(node: Node, args: tuple[Node, ...]) -> Node:
    if node.op == "iff":
        return Node("and", (Node("implies", args), Node("implies", args[::-1])))
    if node.op == "xor":
        left, right = args
        return Node("or", (Node("and", (left, Node("not", (right,)))), Node("and", (Node("not", (left,)), right))))
    return node._replace(args=args)


def parts_of(condition: Node) -> list[Node]:
    """Return what has to be true together for a condition to hold."""
    if condition.op in TOGETHER:
        return [part for child in condition.args for part in parts_of(child)]
    return [condition]


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
