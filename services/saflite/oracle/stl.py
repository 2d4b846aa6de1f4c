"""Signal temporal logic over evenly sampled signals: how far a formula is from being broken, at every sample.

Robustness is the usual one (Donze and Maler 2010; equal to rtamt's discrete-time offline semantics): a comparison is
worth its margin, `and` the least, `or` the greatest, `not` the negative, windows the extremes. Crisp comparisons
(`formula.harden`) are worth plus or minus infinity. What is made of these alone is held in a byte a moment: 1 true, -1
false, 0 unknown, of which least and greatest are what Kleene's logic says: true or false whatever fills the gaps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Refused
from saflite.oracle import windows
from saflite.oracle.formula import CRISP, TEMPORAL, Node
from saflite.oracle.moments import Rows, Uneven
from saflite.oracle.windows import Array


def _divided(a: Any, b: Any) -> Any:
    """Return a / b, NaN (a gap: nothing can be said) where b is 0."""
    return np.where(np.equal(b, 0.0), np.nan, np.divide(a, b))


_CRISP_TYPE = np.dtype(np.int8)
_WORTH = np.array([np.nan, np.inf, -np.inf])  # by a crisp value as the index


def _is_crisp(value: Any) -> bool:
    return getattr(value, "dtype", None) is _CRISP_TYPE


def _worth(value: Any) -> Any:
    """Return the robustness of a crisp value, others as they are."""
    return _WORTH[value] if _is_crisp(value) else value


def _both(a: Any, b: Any) -> Any:
    """Return the robustness of `a and b`; where one is plainly false, the other need not even be a number."""
    if _is_crisp(a) and _is_crisp(b):
        return np.minimum(a, b)
    a, b = _worth(a), _worth(b)
    least = np.minimum(a, b)
    if not np.isnan(least).any():  # as nearly always: the least says it all
        return least
    return np.where(np.equal(a, -np.inf) | np.equal(b, -np.inf), -np.inf, least)


def _either(a: Any, b: Any) -> Any:
    """Return the robustness of `a or b`; where one is plainly true, the other need not even be a number."""
    if _is_crisp(a) and _is_crisp(b):
        return np.maximum(a, b)
    a, b = _worth(a), _worth(b)
    greatest = np.maximum(a, b)
    if not np.isnan(greatest).any():
        return greatest
    return np.where(np.equal(a, np.inf) | np.equal(b, np.inf), np.inf, greatest)


def _implied(a: Any, b: Any) -> Any:
    """Return the robustness of `a implies b`; see `_either`."""
    return _either(-a, b)


def _apart(a: Any, b: Any) -> Any:
    """Return the robustness of `a xor b`."""
    return np.abs(_worth(a) - _worth(b))


def _compared(relation: Callable[[Any, Any], Any], a: Any, b: Any) -> Any:
    """Return crisp values; what is not a number is not known to stand in any relation."""
    stands = np.asarray(relation(a, b)).view(np.int8) * np.int8(2) - np.int8(1)
    unknown = np.isnan(a) | np.isnan(b)
    return np.where(unknown, np.int8(0), stands) if unknown.any() else stands


_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": _divided,
    "pow": np.power,
    "min": np.minimum,
    "max": np.maximum,
    "and": _both,
    "or": _either,
    "<=": lambda a, b: b - a,
    "<": lambda a, b: b - a,
    ">=": lambda a, b: a - b,
    ">": lambda a, b: a - b,
    "==": lambda a, b: -np.abs(a - b),
    "!=": lambda a, b: np.abs(a - b),
    "implies": _implied,
    "iff": lambda a, b: -_apart(a, b),
    "xor": _apart,
}
_UNARY: dict[str, Callable[[Any], Any]] = {
    "not": np.negative,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "turn": lambda angle: (angle + 180.0) % 360.0 - 180.0,
    "sin": lambda angle: np.sin(np.radians(angle)),
    "cos": lambda angle: np.cos(np.radians(angle)),
}
_CRISP: dict[str, Callable[[Any, Any], Any]] = {
    "<=": np.less_equal,
    "<": np.less,
    ">=": np.greater_equal,
    ">": np.greater,
    "==": np.equal,
    "!=": np.not_equal,
}


class _Windows(Protocol):
    """Extremes over windows of samples, as the functions in `windows`."""

    def least_ahead(self, values: Array, low: int, high: int | None) -> Array: ...
    def greatest_ahead(self, values: Array, low: int, high: int | None) -> Array: ...
    def least_behind(self, values: Array, low: int, high: int | None) -> Array: ...
    def greatest_behind(self, values: Array, low: int, high: int | None) -> Array: ...
    def until(self, left: Array, right: Array, low: int, high: int | None) -> Array: ...
    def since(self, left: Array, right: Array, low: int, high: int | None) -> Array: ...


_EVEN: _Windows = windows


class Evaluator:
    """Evaluates formulas over one trace; parts that formulas share (`formula.interned`) are computed once.

    Args:
        signals: name to values, each of shape (n,); any float type.
        step_s: time between samples.
        row: the sample at or before each of the n moments, where some samples have further moments after them
            (`moments.py`); None where all are samples. `prev`, `rise` and the like go by moments, times by samples.
    """

    def __init__(self, signals: Mapping[str, Any], step_s: float, row: Rows | None = None) -> None:
        self._signals, self.step_s = signals, step_s
        self.samples = min((len(values) for values in signals.values()), default=0)
        even = np.arange(self.samples, dtype=np.intp)
        self.row = even if row is None else row[: self.samples]
        self._even = len(self.row) == 0 or self.row[-1] == even[-1]
        self._windows: _Windows = _EVEN if self._even else Uneven(self.row)
        self._known: dict[int, tuple[Node, Any]] = {}

    def trace(self, node: Node) -> Array:
        """Return the robustness (or the value of a term) at every sample, shape (n,).

        Raises:
            Refused: a signal is missing.
        """
        return np.asarray(_worth(self._array(node)), dtype=np.float64)

    def true(self, node: Node) -> NDArray[np.bool_]:
        """Return where a formula is plainly true, shape (n,)."""
        return np.asarray(self._array(node) > 0)

    def _array(self, node: Node) -> NDArray[Any]:
        """Return the value of a node at every sample: of a term, as robustness, or crisp."""
        known = self._known.get(id(node))
        if known is None:
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                known = (node, self._value(node))
        value = known[1]
        return value if isinstance(value, np.ndarray) and value.ndim else np.full(self.samples, value)

    def _value(self, node: Node) -> Any:
        """Value of the node: an array, or a plain number where it does not depend on time."""
        if node.op == "number":
            return node.value
        known = self._known.get(id(node))
        if known is None:
            known = self._known[id(node)] = (node, self._computed(node))  # held, so that no other node takes its id
        return known[1]

    def _computed(self, node: Node) -> Any:
        op = node.op
        if op == "signal":
            return self._signal(node.name)
        if op.startswith(CRISP):
            left, right = (self._value(arg) for arg in node.args)
            return _compared(_CRISP[op[len(CRISP) :]], left, right)
        if op in _BINARY:
            return _BINARY[op](self._value(node.args[0]), self._value(node.args[1]))
        if op in _UNARY:
            return _UNARY[op](self._value(node.args[0]))
        args = [self._array(arg) for arg in node.args]
        return self._windowed(node, args) if op in TEMPORAL else self._over_time(node, args)

    def _windowed(self, node: Node, args: list[NDArray[Any]]) -> NDArray[Any]:
        low = self._count(node.low_s)
        high = None if math.isinf(node.high_s) else self._count(node.high_s)
        if node.op in ("until", "since"):
            joined = self._windows.until if node.op == "until" else self._windows.since
            return joined(_worth(args[0]), _worth(args[1]), low, high)
        values = args[0]
        if node.op == "lasting":
            assert high is not None, "lasting has a length"
            least = self._windows.least_behind(values, 0, high)
            return np.where(self.row < high, -windows.top(least), least)
        if node.op == "always":
            return self._windows.least_ahead(values, low, high)
        if node.op == "eventually":
            return self._windows.greatest_ahead(values, low, high)
        if node.op == "historically":
            return self._windows.least_behind(values, low, high)
        return self._windows.greatest_behind(values, low, high)

    def _over_time(self, node: Node, args: list[NDArray[Any]]) -> NDArray[Any]:
        values, op = args[0], node.op
        if op in ("prev", "rise", "fall", "next"):
            edge = np.array([-windows.top(values) if op == "rise" else windows.top(values)])
            if op == "next":
                return np.concatenate([values[1:], edge])
            before = np.concatenate([edge, values[:-1]])
            if op == "prev":
                return before
            return np.asarray(np.minimum(-before, values) if op == "rise" else np.minimum(before, -values))
        if op == "latch":
            return _latch(values, args[1])
        if op == "before":
            return _shifted(values, 1)
        return (
            self._by_samples(node, values) if self._even else self._by_samples(node, self._at_samples(values))[self.row]
        )

    def _at_samples(self, values: Array) -> Array:
        return values[np.searchsorted(self.row, np.arange(self.row[-1] + 1))]

    def _by_samples(self, node: Node, values: Array) -> Array:
        """Return a term that looks back by a time, shape (samples,): further moments see what their sample sees."""
        if node.op == "mean":
            return _mean(values, self._count(node.value))
        past = _shifted(values, 1 if node.op == "rate" else self._count(node.value))
        return np.asarray((values - past) / self.step_s) if node.op == "rate" else past

    def _signal(self, name: str) -> Array:
        if name not in self._signals:
            raise Refused("signal", expected=f"one of {', '.join(sorted(self._signals))}", got=repr(name))
        return np.asarray(self._signals[name][: self.samples], dtype=np.float64)

    def _count(self, seconds: float) -> int:
        return math.floor(seconds / self.step_s + 0.5)


def _shifted(values: Array, count: int) -> Array:
    """Values `count` samples ago; before the first sample the first value holds."""
    if count == 0 or len(values) == 0:
        return values
    count = min(count, len(values))
    return np.concatenate([np.full(count, values[0]), values[: len(values) - count]])


def _mean(values: Array, count: int) -> Array:
    """Mean of the last `count` samples (fewer at the start); not known while one of them is not."""
    count = max(1, min(count, len(values)))
    index = np.arange(1, len(values) + 1)
    first = np.maximum(index - count, 0)

    def over(given: NDArray[Any]) -> NDArray[Any]:
        total = np.concatenate([[0.0], np.cumsum(given)])
        return np.asarray(total[index] - total[first])

    gaps = np.isnan(values)
    if not gaps.any():
        return over(values) / (index - first)
    return np.where(over(gaps) > 0, np.nan, over(np.where(gaps, 0.0, values)) / (index - first))


def _latch(values: Array, condition: Array) -> Array:
    """Value at the moment the condition last became true; the value itself while it never was."""
    became = np.flatnonzero(np.diff(condition > 0, prepend=False) & (condition > 0))
    if not len(became):
        return values
    held = np.repeat(values[became], np.diff(became, append=len(values)))
    return np.concatenate([values[: became[0]], held])
