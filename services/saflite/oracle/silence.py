"""Does a stimulus silence a rule for the whole flight? A formula is read with its flags held at 0.

Three-valued: true, false, or not known (None). A rule `condition implies promise` is silent where its condition is
false whatever else happens.
"""

from __future__ import annotations

import operator
from collections.abc import Callable

from saflite.oracle.formula import CRISP, Node

Truth = bool | None
_COMPARE: dict[str, Callable[[float, float], bool]] = {
    "<=": operator.le,
    "<": operator.lt,
    ">=": operator.ge,
    ">": operator.gt,
    "==": operator.eq,
    "!=": operator.ne,
}


def is_silenced(formula: Node, flags: frozenset[str]) -> bool:
    """Say whether the rule can never apply while `flags` are 0."""
    body = formula.args[0] if formula.op == "always" else formula
    if body.op == "and":
        return all(is_silenced(part, flags) for part in body.args)
    return body.op == "implies" and _truth(body.args[0], flags) is False


def _truth(node: Node, flags: frozenset[str]) -> Truth:
    op = node.op.removeprefix(CRISP)
    if op in _COMPARE:
        left, right = (_number(arg, flags) for arg in node.args)
        return None if left is None or right is None else _COMPARE[op](left, right)
    parts = [_truth(arg, flags) for arg in node.args]
    if op in ("rise", "fall"):
        return False if parts[0] is not None else None
    if op in ("and", "until", "since"):
        return False if False in parts else None if None in parts else True
    if op == "or":
        return True if True in parts else None if None in parts else False
    if op == "not":
        return None if parts[0] is None else not parts[0]
    if op in ("lasting", "always", "historically", "eventually", "once", "prev", "next"):
        return parts[0]
    return None


def _number(node: Node, flags: frozenset[str]) -> float | None:
    if node.op == "number":
        return node.value
    return 0.0 if node.op == "signal" and node.name in flags else None
