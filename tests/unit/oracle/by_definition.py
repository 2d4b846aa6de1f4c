"""Robustness straight from the definitions that the pages give, one moment at a time: slow, and without shared code."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import accumulate
from typing import Self

from saflite.oracle.formula import CRISP, Node, reach_s, signals_of
from saflite.oracle.windows import Array

signals_under = cache(signals_of)
INF = math.inf
Floats = list[float]


def least(values: Sequence[float]) -> float:
    """Return the least, plus infinity for none, NaN where one is."""
    return math.nan if math.isnan(sum(values)) and any(map(math.isnan, values)) else min(values, default=INF)


def greatest(values: Sequence[float]) -> float:
    """Return the greatest, minus infinity for none, NaN where one is."""
    return -least([-one for one in values])


def low_of(a: float, b: float) -> float:
    """Return the lesser of two, NaN where one is (`least` of both, which takes thrice as long)."""
    return a if a < b or a != a else b


def high_of(a: float, b: float) -> float:
    """Return the greater of two, NaN where one is."""
    return a if a > b or a != a else b


def implied(a: float, b: float) -> float:
    """A rule that does not apply asks nothing, not even that its other half is a number."""
    return INF if a == -INF else high_of(-a, b)


def turned(angle: float) -> float:
    """An angle brought to -180..180 degrees."""
    return (angle + 180.0) % 360.0 - 180.0


TWO: dict[str, Callable[[float, float], float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b if b else math.nan,
    "pow": lambda a, b: a**b,
    "min": low_of,
    "max": high_of,
    "and": low_of,
    "or": high_of,
    "<=": lambda a, b: b - a,
    "<": lambda a, b: b - a,
    ">=": lambda a, b: a - b,
    ">": lambda a, b: a - b,
    "==": lambda a, b: -abs(a - b),
    "!=": lambda a, b: abs(a - b),
    "implies": implied,
    "iff": lambda a, b: -abs(a - b),
    "xor": lambda a, b: abs(a - b),
    "is<=": lambda a, b: INF if a <= b else -INF,
    "is<": lambda a, b: INF if a < b else -INF,
    "is>=": lambda a, b: INF if a >= b else -INF,
    "is>": lambda a, b: INF if a > b else -INF,
    "is==": lambda a, b: INF if a == b else -INF,
    "is!=": lambda a, b: INF if a != b else -INF,
}
ONE: dict[str, Callable[[float], float]] = {
    "not": lambda a: -a,
    "neg": lambda a: -a,
    "abs": abs,
    "sqrt": lambda a: math.sqrt(a) if a >= 0.0 else math.nan,
    "exp": math.exp,
    "turn": turned,
    "sin": lambda a: math.sin(math.radians(a)),
    "cos": lambda a: math.cos(math.radians(a)),
}


class Definition:
    """A formula over moments. `row` is the sample of each, several of one sample follow each other.

    What depends on no signal that is another object than `before`, at the same moments, is not worked out again.
    """

    def __init__(
        self, signals: Mapping[str, Array], step_s: float, row: Sequence[int], before: Self | None = None
    ) -> None:
        self.signals, self.step_s, self.row = signals, step_s, list(row)
        self.known: dict[Node, Floats] = {}
        if before is not None and (before.step_s, before.row) == (step_s, self.row):
            same = {name for name, values in signals.items() if before.signals.get(name) is values}
            self.known = {node: worth for node, worth in before.known.items() if signals_under(node) <= same}

    def holds(self, formula: Node) -> bool:
        """Whether `always body` holds wherever the body's windows lie inside the flight."""
        assert formula.op == "always", "a policy says what is always so"
        (body,) = formula.args
        last = self.row[-1] - (math.ceil(reach_s(body) / self.step_s - 1e-9) if math.isfinite(reach_s(body)) else 0)
        first = round(formula.low_s / self.step_s)
        values = [value for value, row in zip(self.values(body), self.row, strict=True) if first <= row <= last]
        return not least(values) < 0.0

    def values(self, node: Node) -> Floats:
        """Return what a node is worth at every moment."""
        if node not in self.known:
            self.known[node] = self.worked_out(node)
        return self.known[node]

    def worked_out(self, node: Node) -> Floats:
        """See `values`."""
        moments = range(len(self.row))
        if node.op in ("number", "signal"):
            return [node.value] * len(self.row) if node.op == "number" else [*map(float, self.signals[node.name])]
        below = [self.values(child) for child in node.args]
        if node.op in TWO or node.op.startswith(CRISP):
            return [TWO[node.op](a, b) for a, b in zip(*below, strict=True)]
        if node.op in ONE:
            return [ONE[node.op](a) for a in below[0]]
        if node.op == "latch":
            return self.latched(*below)
        return [getattr(self, f"at_{node.op}")(node, at, *below) for at in moments]

    def count(self, seconds: float) -> float:
        """Return a time in samples."""
        return INF if math.isinf(seconds) else math.floor(seconds / self.step_s + 0.5)

    def ahead(self, node: Node, at: int) -> range:
        """Return the moments from this one on that lie in the node's window, by the clock."""
        low, high = (self.row[at] + self.count(bound) for bound in (node.low_s, node.high_s))
        return range(bisect_left(self.row, low, at), bisect_right(self.row, high))

    def behind(self, node: Node, at: int) -> range:
        """Return the moments up to this one that lie in the node's window, by the clock."""
        low, high = (self.row[at] - self.count(bound) for bound in (node.high_s, node.low_s))
        return range(bisect_left(self.row, low), bisect_right(self.row, high, 0, at + 1))

    def at_always(self, node: Node, at: int, a: Floats) -> float:
        return least([a[one] for one in self.ahead(node, at)])

    def at_eventually(self, node: Node, at: int, a: Floats) -> float:
        return greatest([a[one] for one in self.ahead(node, at)])

    def at_historically(self, node: Node, at: int, a: Floats) -> float:
        return least([a[one] for one in self.behind(node, at)])

    def at_once(self, node: Node, at: int, a: Floats) -> float:
        return greatest([a[one] for one in self.behind(node, at)])

    def at_lasting(self, node: Node, at: int, a: Floats) -> float:
        return -INF if self.row[at] < self.count(node.high_s) else self.at_historically(node, at, a)

    def at_until(self, node: Node, at: int, a: Floats, b: Floats) -> float:
        so_far, window = [*accumulate(a[at:], low_of, initial=INF)], self.ahead(node, at)
        return greatest([low_of(b[one], so_far[one - at]) for one in window])

    def at_since(self, node: Node, at: int, a: Floats, b: Floats) -> float:
        so_far, window = [*accumulate(a[at::-1], low_of, initial=INF)], self.behind(node, at)
        return greatest([low_of(b[one], so_far[at - one]) for one in window])

    def at_rise(self, _: Node, at: int, a: Floats) -> float:
        return low_of(-a[at - 1] if at else INF, a[at])

    def at_fall(self, _: Node, at: int, a: Floats) -> float:
        return low_of(a[at - 1] if at else INF, -a[at])

    def at_prev(self, _: Node, at: int, a: Floats) -> float:
        return a[at - 1] if at else INF

    def at_next(self, _: Node, at: int, a: Floats) -> float:
        return a[at + 1] if at + 1 < len(a) else INF

    def at_before(self, _: Node, at: int, a: Floats) -> float:
        return a[max(0, at - 1)]

    def latched(self, a: Floats, b: Floats) -> Floats:
        """Return what the first showed where the second last began, before it ever did what the first shows."""
        began: int | None = None
        held = []
        for at in range(len(a)):
            if b[at] > 0 and not (at and b[at - 1] > 0):
                began = at
            held.append(a[at if began is None else began])
        return held

    def sample(self, a: Floats, row: float) -> float:
        """Return what held at a sample; before the first what the first shows."""
        return a[self.row.index(max(0, int(row)))]

    def at_ago(self, node: Node, at: int, a: Floats) -> float:
        return self.sample(a, self.row[at] - self.count(node.value))

    def at_rate(self, _: Node, at: int, a: Floats) -> float:
        return (self.sample(a, self.row[at]) - self.sample(a, self.row[at] - 1)) / self.step_s

    def at_mean(self, node: Node, at: int, a: Floats) -> float:
        count = min(self.row[at] + 1, max(1, self.count(node.value)))
        return sum(self.sample(a, self.row[at] - back) for back in range(int(count))) / count
