"""Units of terms: what may be added and compared. A bare number fits any unit."""

from __future__ import annotations

from collections.abc import Mapping

from saflite.contract.errors import Refused
from saflite.contract.signals import SIGNALS, Signal
from saflite.oracle.formula import COMPARISONS, Node, parts, text_of

_KEEPING = ("neg", "abs", "before", "ago", "mean", "latch", "turn")
_JOINING = ("+", "-", "min", "max", *COMPARISONS)
ANY = "any"


def unit_of(node: Node, where: str = "", table: Mapping[str, Signal] = SIGNALS) -> str:
    """Return the unit of a term ('' for plain numbers with a meaning of their own, 'any' for constants).

    Raises:
        Refused: two sides of a sum, a choice or a comparison differ in unit.
    """
    return _units(parts(node), where, table)[id(node)]


def _units(found: list[Node], where: str, table: Mapping[str, Signal]) -> dict[int, str]:
    """Return the unit of each part, by its place in memory; arguments come before what they are arguments of."""
    known: dict[int, str] = {}
    for part in found:
        known[id(part)] = _unit(part, [known[id(child)] for child in part.args], where, table)
    return known


def _unit(node: Node, units: list[str], where: str, table: Mapping[str, Signal]) -> str:
    if node.op == "number":
        return ANY
    if node.op == "signal":
        return table[node.name].unit
    if node.op in _KEEPING:
        return units[0]
    if node.op in _JOINING:
        return _joined(node, units, where)
    if node.op == "rate":
        return ANY if units[0] == ANY else f"{units[0]}/s"
    if node.op in ("*", "/"):
        return _multiplied(node.op, units)
    return ANY


def _joined(node: Node, units: list[str], where: str) -> str:
    named = [unit for unit in units if unit != ANY]
    if len(named) == 2 and named[0] != named[1]:
        sides = " and ".join(f"{text_of(arg)} [{unit}]" for arg, unit in zip(node.args, units, strict=True))
        raise Refused("formula", where=where, expected=f"one unit on both sides of '{node.op}'", got=sides)
    if node.op in COMPARISONS:
        return ANY
    return named[0] if named else ANY


def _multiplied(op: str, units: list[str]) -> str:
    left, right = units
    if right == ANY:
        return left
    if left == ANY and op == "*":
        return right
    return "" if op == "/" and left == right else ANY


def margin_unit(node: Node, where: str = "", table: Mapping[str, Signal] = SIGNALS) -> str:
    """Return the unit robustness is in: that of the comparisons which are not crisp, '' if they differ or are none.

    Raises:
        Refused: as `unit_of`.
    """
    found = parts(node)
    units = _units(found, where, table)
    compared = {units[id(side)] for part in found if part.op in COMPARISONS for side in part.args} - {ANY}
    return compared.pop() if len(compared) == 1 else ""
