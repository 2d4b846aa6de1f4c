"""Our robustness equals rtamt's on 10,000 generated pairs of formula and trace.

rtamt is not asked with windows longer than the trace in formulas that use a signal twice: its timed operators then
lengthen the caller's list in place and disagree with themselves. Below `iff` and `xor` only finite robustness is
generated: the difference of two infinities has no value, and which one rtamt gives depends on the order of arguments.
"""

from __future__ import annotations

import random

import numpy as np
import pytest

from saflite.oracle.formula import text_of
from saflite.oracle.parse import parse
from saflite.oracle.stl import Evaluator

rtamt = pytest.importorskip("rtamt", reason="rtamt needs Python below 3.13")

PAIRS, PARTS = 10_000, 10
BY_DEFAULT = 2  # of the parts; the others are as many again of the same kind, for the live tests
BINARY = ("and", "or", "implies", "iff", "xor")
WINDOWED = ("always", "eventually", "historically", "once")


def term(draw: random.Random, depth: int) -> str:
    kind = draw.choice(["+", "-", "*", "abs", "leaf"]) if depth else "leaf"
    if kind == "leaf":
        return draw.choice(["a", "b", "c", f"{draw.uniform(0, 3):.2f}"])
    if kind == "abs":
        return f"abs({term(draw, depth - 1)})"
    return f"({term(draw, depth - 1)} {kind} {term(draw, depth - 1)})"


def window(draw: random.Random, finite: bool) -> str:
    low = 0 if finite else draw.randint(0, 4)
    return f"[{low}:{low + draw.randint(0, 5)}]" if draw.random() < 0.7 else ""


def formula(draw: random.Random, depth: int, finite: bool = False) -> str:
    if depth == 0:
        comparison = draw.choice(["<=", "<", ">=", ">", "==", "!="])
        return f"({term(draw, draw.randint(0, 2))} {comparison} {term(draw, 1)})"
    kinds = ["not", "rise", "fall", "until", "since", *BINARY, *WINDOWED]
    kind = draw.choice(kinds if finite else [*kinds, "prev", "next"])
    finite = finite or kind in ("iff", "xor")
    left = formula(draw, depth - 1, finite)
    if kind in ("not", *WINDOWED):
        return f"({kind}{window(draw, finite) if kind in WINDOWED else ''} {left})"
    if kind in ("rise", "fall", "prev", "next"):
        return f"{kind}({left})"
    bounds = window(draw, finite) if kind in ("until", "since") else ""
    return f"({left} {kind}{bounds} {formula(draw, depth - 1, finite)})"


def by_rtamt(text: str, signals: dict[str, list[float]], samples: int) -> list[float]:
    specification = rtamt.StlDiscreteTimeSpecification()
    for name in signals:
        specification.declare_var(name, "float")
    specification.spec = text.replace("!=", "!==")
    specification.parse()
    data = {"time": list(range(samples)), **{name: list(values) for name, values in signals.items()}}
    return [value for _, value in specification.evaluate(data)]


def close(ours: float, theirs: float) -> bool:
    return ours == theirs or abs(ours - theirs) <= 1e-9 or (np.isnan(ours) and np.isnan(theirs))


@pytest.mark.parametrize(
    "part", [pytest.param(part, marks=[pytest.mark.live] if part >= BY_DEFAULT else []) for part in range(PARTS)]
)
def test_robustness_equals_rtamt(part: int) -> None:
    for pair in range(part * PAIRS // PARTS, (part + 1) * PAIRS // PARTS):
        draw = random.Random(pair)
        text, samples = formula(draw, draw.randint(1, 4)), draw.randint(10, 25)
        values = [draw.uniform(-3, 3), *(float(whole) for whole in range(-3, 4))]
        signals = {name: [draw.choice(values) for _ in range(samples)] for name in "abc"}
        theirs = by_rtamt(text, signals, samples)
        node = parse(text)
        ours = Evaluator({name: np.array(held) for name, held in signals.items()}, 1.0).trace(node)
        assert parse(text_of(node)) == node
        assert len(theirs) == samples, f"pair {pair}: {text}"
        assert all(map(close, ours, theirs)), f"pair {pair}: {text}"
