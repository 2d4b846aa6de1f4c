"""Moments between samples: what held between stimuli of one instant, and windows over them."""

from __future__ import annotations

import time

import numpy as np
import pytest
from by_definition import Definition

from saflite.contract.flight import Delivered, Trace
from saflite.contract.rng import derive
from saflite.oracle import windows
from saflite.oracle.formula import Node
from saflite.oracle.moments import Uneven, moments_of, samples_of
from saflite.oracle.parse import parse
from saflite.oracle.stl import Evaluator


def trace(**signals: list[float]) -> Trace:
    return Trace(step_s=0.5, signals={name: np.asarray(held, "<f4").tobytes() for name, held in signals.items()})


def test_each_change_has_a_moment_in_the_order_given() -> None:
    flown = trace(mode=[4, 4, 14, 14], armed=[1, 1, 1, 1])
    told = [Delivered(index=0, at_s=0.5, changed={"mode": 2.0}), Delivered(index=1, at_s=0.5, changed={"mode": 14.0})]
    moments = moments_of(flown, told)
    assert moments.row.tolist() == [0, 1, 1, 1, 2, 3]
    assert moments.time_s.tolist() == [0.0, 0.5, 0.5, 0.5, 1.0, 1.5]
    assert moments.held("mode", flown.array("mode")).tolist() == [4, 4, 2, 14, 14, 14]
    assert moments.held("armed", flown.array("armed")).tolist() == [1] * 6


def test_nothing_told_or_nothing_shown_leaves_the_samples() -> None:
    flown = trace(mode=[4, 4])
    for told in (None, [Delivered(index=0, at_s=0.0)], [Delivered(index=0, at_s=0.5, changed={"mode": 2.0})]):
        assert moments_of(flown, told).row.tolist() == samples_of(flown).row.tolist()


@pytest.mark.parametrize(("low", "high"), [(0, 0), (0, 3), (2, 5), (1, None), (0, None), (30, 40)])
def test_windows_over_even_moments_are_those_over_samples(low: int, high: int | None) -> None:
    rng = derive(1, "test-moments")
    left, right = rng.normal(size=(2, 25))
    uneven = Uneven(np.arange(25))
    for name in ("least_ahead", "greatest_ahead", "least_behind", "greatest_behind"):
        found, known = getattr(uneven, name)(left, low, high), getattr(windows, name)(left, low, high)
        assert found.tolist() == known.tolist(), name
    for name in ("until", "since"):
        found, known = getattr(uneven, name)(left, right, low, high), getattr(windows, name)(left, right, low, high)
        assert found.tolist() == known.tolist(), name


def test_windows_go_by_time_and_events_by_moments() -> None:
    row = np.array([0, 1, 1, 2, 3])
    evaluator = Evaluator({"altitude_m": np.array([5.0, 5.0, 1.0, 5.0, 5.0])}, 1.0, row)
    assert evaluator.trace(parse("always[0:1] (altitude_m >= 0)")).tolist() == [1.0, 1.0, 1.0, 5.0, 5.0]
    assert evaluator.trace(parse("historically[0:1] (altitude_m >= 0)")).tolist() == [5.0, 5.0, 1.0, 1.0, 5.0]
    assert evaluator.trace(parse("lasting[1] (altitude_m >= 0)")).tolist() == [-np.inf, 5.0, 1.0, 1.0, 5.0]
    assert evaluator.trace(parse("rise(altitude_m >= 3)")).tolist() == [2.0, -2.0, -2.0, 2.0, -2.0]
    assert evaluator.trace(parse("ago(altitude_m, 1) >= 0")).tolist() == [5.0, 5.0, 5.0, 5.0, 5.0]


@pytest.mark.parametrize("low", [0, 1, 3])
@pytest.mark.parametrize("longer", [0, 1, 4, 40])
def test_windows_over_uneven_moments_are_those_by_definition(low: int, longer: int) -> None:
    rng, a, b = derive(2, "test-moments"), Node("signal", name="a"), Node("signal", name="b")
    for _ in range(12):
        row = np.repeat(np.arange(20), rng.choice([1, 1, 1, 2, 4], size=20))
        known = rng.choice([-np.inf, -1.5, 0.5, 2.0, np.inf], size=(2, len(row)))
        gappy = np.where(rng.random(len(row)) < 0.1, np.nan, known[0])
        for op in ("always", "eventually", "historically", "once", "until", "since"):
            signals = {"a": known[0] if op in ("until", "since") else gappy, "b": known[1]}
            node = Node(op, (a, b) if op in ("until", "since") else (a,), float(low), float(low + longer))
            told = Evaluator(signals, 1.0, row).trace(node)
            assert np.array_equal(told, Definition(signals, 1.0, row.tolist()).values(node), equal_nan=True), op


def test_until_without_end_is_that_by_definition_and_forgets_a_gap() -> None:
    rng, node = derive(3, "test-moments"), Node("until", (Node("signal", name="a"), Node("signal", name="b")))
    for samples in (1, 2, 3, 8, 31, 100):
        left, right = rng.choice([-np.inf, -1.5, 0.5, 2.0, np.inf], size=(2, samples))
        told = windows.until(left, right, 0, None).tolist()
        assert told == Definition({"a": left, "b": right}, 1.0, range(samples)).values(node)
    assert windows.until(np.array([1.0, 1.0, 1.0]), np.array([-1.0, np.nan, 2.0]), 0, None)[0] == 1.0


@pytest.mark.parametrize("extra", [0, 10])
@pytest.mark.parametrize(("low", "high"), [(0, 3_000_000), (0, 100_000), (5_000, 200_000)])
def test_wide_windows_take_no_longer_than_narrow_ones(low: int, high: int, extra: int) -> None:
    """A trace of a lying worker may hold a million samples in a second: each window went through all of them."""
    row = np.sort(np.concatenate([np.arange(2**18), np.arange(extra)]))
    left, right = derive(4, "test-moments").normal(size=(2, len(row)))
    over = Uneven(row) if extra else windows
    began_s = time.process_time()
    for joined in (over.until, over.since):
        assert len(joined(left, right, low, high)) == len(row)
    assert time.process_time() - began_s < 5.0, "measured: 0.1 s; sample by sample half a minute and more"


@pytest.mark.parametrize("known", [(-np.inf, -1.5, 0.5, 2.0, np.inf), (-np.inf, -1.5, 0.5, 2.0, np.inf, np.nan)])
def test_windows_of_until_are_those_that_go_sample_by_sample(known: tuple[float, ...]) -> None:
    rng = derive(5, "test-moments")
    for _ in range(300):
        n, low = int(rng.integers(0, 40)), int(rng.integers(0, 45))
        left, right = rng.choice(known, size=(2, n))
        high = low + int(rng.integers(0, 45))
        told = [
            np.max(
                [np.minimum(np.min(left[i:j], initial=np.inf), right[j]) for j in range(i + low, min(i + high + 1, n))]
            )
            if i + low < n
            else -np.inf
            for i in range(n)
        ]
        assert np.array_equal(windows.until(left, right, low, high), told, equal_nan=True)
        assert n == 0 or np.array_equal(Uneven(np.arange(n)).until(left, right, low, high), told, equal_nan=True)
