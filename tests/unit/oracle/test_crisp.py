"""Crisp values: what is made of plain conditions alone, true, false or, where a signal has a gap, unknown."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from saflite.oracle.formula import harden
from saflite.oracle.moments import Uneven
from saflite.oracle.parse import parse
from saflite.oracle.stl import Evaluator
from saflite.oracle.windows import Array

INF = math.inf
SAMPLES = 9
GIVEN = {-1.0: -INF, 1.0: INF}  # what `a > 0` is worth; NaN for a gap


def trace(text: str, row: list[int] | None = None, **signals: Array) -> list[float]:
    evaluator = Evaluator(signals, 1.0, None if row is None else np.asarray(row))
    return [float(one) for one in evaluator.trace(harden(parse(text), lambda _: True))]


def worth(values: Array) -> list[float]:
    return [GIVEN.get(float(one), math.nan) for one in values]


def least(values: list[float]) -> float:
    """Return the least of a window: false where any is, else unknown where any is."""
    return -INF if -INF in values else math.nan if any(map(math.isnan, values)) else min(values, default=INF)


def same(told: list[float], asked: list[float]) -> bool:
    return np.array_equal(told, asked, equal_nan=True)


def every() -> list[Array]:
    """Return columns in which each two of true, false and unknown meet."""
    pairs = [*itertools.product((1.0, -1.0, math.nan), repeat=2)]
    return [np.array([pair[side] for pair in pairs]) for side in (0, 1)]


def test_conditions_are_joined_as_kleene_says() -> None:
    a, b = every()
    joins: dict[str, Callable[[float, float], float]] = {
        "(a > 0) and (b > 0)": lambda x, y: least([x, y]),
        "(a > 0) or (b > 0)": lambda x, y: -least([-x, -y]),
        "(a > 0) implies (b > 0)": lambda x, y: -least([x, -y]),
    }
    for text, joined in joins.items():
        assert same(trace(text, a=a, b=b), [joined(x, y) for x, y in zip(worth(a), worth(b), strict=True)]), text
    assert same(trace("not (a > 0)", a=a), [-one for one in worth(a)])


@pytest.mark.parametrize("rng_seed", range(6))
def test_windows_of_conditions_say_what_is_so_whatever_fills_their_gaps(rng_seed: int) -> None:
    rng = np.random.default_rng(rng_seed)
    a = rng.choice([1.0, 1.0, -1.0, math.nan] if rng_seed % 2 else [1.0, -1.0], SAMPLES)
    known = worth(a)
    ahead = [known[place : place + 3] for place in range(SAMPLES)]
    behind = [known[max(0, place - 2) : place + 1] for place in range(SAMPLES)]
    assert same(trace("always[0:2] (a > 0)", a=a), [least(one) for one in ahead])
    assert same(trace("eventually[0:2] (a > 0)", a=a), [-least([-x for x in one]) for one in ahead])
    assert same(trace("historically[0:2] (a > 0)", a=a), [least(one) for one in behind])
    assert same(trace("once[0:2] (a > 0)", a=a), [-least([-x for x in one]) for one in behind])
    assert same(trace("lasting[2] (a > 0)", a=a), [-INF, -INF, *(least(one) for one in behind[2:])])
    assert same(trace("prev(a > 0)", a=a), [INF, *known[:-1]])
    assert same(trace("next(a > 0)", a=a), [*known[1:], INF])
    assert same(trace("rise(a > 0)", a=a), [least([-x, y]) for x, y in itertools.pairwise([-INF, *known])])
    assert same(trace("fall(a > 0)", a=a), [least([x, -y]) for x, y in itertools.pairwise([INF, *known])])


def test_moments_between_samples_change_nothing_of_that() -> None:
    row = [0, 1, 1, 2, 3, 3, 3, 4, 5]
    a = np.array([1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    for text, window in (
        ("always[0:1] (a > 0)", Uneven(np.asarray(row)).least_ahead(np.array(worth(a)), 0, 1)),
        ("once[0:1] (a > 0)", Uneven(np.asarray(row)).greatest_behind(np.array(worth(a)), 0, 1)),
    ):
        assert same(trace(text, row, a=a), [float(one) for one in window]), text


def test_conditions_beside_margins_are_worth_infinity() -> None:
    a, b = np.array([1.0, -1.0, math.nan, 1.0]), np.array([0.5, 0.5, 0.5, -2.0])
    evaluator = Evaluator({"a": a, "b": b}, 1.0)
    told = evaluator.trace(harden(parse("(a > 0) implies (b > 0)"), lambda _: False))
    assert same([float(one) for one in told], [0.5, INF, math.nan, -2.0])
