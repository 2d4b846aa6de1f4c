"""Calibration against direct counting, the paper's own table and sklearn."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.rng import derive
from saflite.scorer_pool.calibration import (
    Confusion,
    Row,
    calibrate,
    calibrate_all,
    metrics,
    reliability,
    roc_area,
    wilson,
)


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        ((24, 10, 12, 24), (68.6, 68.6, 70.6, 66.7)),  # GPT-3.5
        ((26, 16, 10, 18), (62.9, 66.7, 61.9, 72.2)),  # Mistral-7B
        ((22, 23, 14, 11), (47.1, 54.3, 48.9, 61.1)),  # Llama-2-7B
    ],
)
def test_reproduces_the_papers_table_from_the_only_counts_that_fit_it(
    cells: tuple[int, int, int, int], expected: tuple[float, ...]
) -> None:
    got = metrics(
        Confusion(true_positive=cells[0], false_positive=cells[1], false_negative=cells[2], true_negative=cells[3])
    )
    values = [got.accuracy.value, got.f1.value, got.precision.value, got.recall.value]
    assert [round(100 * value, 1) for value in values if value is not None] == list(expected)
    for interval in (got.accuracy, got.f1, got.precision, got.recall):
        assert interval.value is not None
        assert interval.low is not None
        assert interval.high is not None
        assert interval.low < interval.value < interval.high


def test_roc_area_equals_sklearn_with_ties() -> None:
    from sklearn.metrics import roc_auc_score

    rng = derive(1, "roc")
    for _ in range(50):
        truth = rng.random(60) < 0.4
        scores = np.round(rng.random(60) * 10 * (0.5 + truth), 0)
        area = roc_area(truth, scores)
        if truth.all() or not truth.any():
            assert area is None
        else:
            assert area == pytest.approx(float(roc_auc_score(truth, scores)), abs=1e-12)


def test_wilson_interval_of_known_case() -> None:
    got = wilson(48, 70)
    assert got.low == pytest.approx(0.5700, abs=5e-4)
    assert got.high == pytest.approx(0.7823, abs=5e-4)
    assert wilson(0, 0).value is None
    assert wilson(0, 5).low == 0.0


def test_reliability_counts_every_pair_once() -> None:
    scores = np.array([0.0, 1.99, 2.0, 4.0, 7.0, 8.0, 10.0])
    violated = np.array([False, False, True, False, True, True, True])
    bands = reliability(scores, violated)
    assert [band.count for band in bands] == [2, 1, 1, 1, 2]
    assert [band.violated.value for band in bands] == [0.0, 1.0, 0.0, 1.0, 1.0]


def test_random_share_gives_the_unbiased_figures_and_baselines_stand_beside() -> None:
    rng = derive(2, "calibrate")
    rows = []
    for _ in range(4000):
        value = float(rng.uniform(0, 10))
        violated = bool(rng.random() < value / 10)
        chosen = "score" if value > 5 else ("random" if rng.random() < 0.3 else "")
        rows += [Row("m", value, violated, "random")] if rng.random() < 0.2 else []
        rows += [Row("m", value, violated, "score")] if chosen == "score" else []
    everything, fair = calibrate_all(rows)
    assert (everything.sample, fair.sample) == ("all", "random")
    assert fair.flights < everything.flights
    assert fair.roc_area.value == pytest.approx(5 / 6, abs=0.03)  # the area of a perfectly calibrated uniform score
    assert fair.always.recall.value == 1.0
    assert fair.never.recall.value == 0.0
    assert fair.always.accuracy.value == pytest.approx(fair.violations / fair.flights)


def test_nothing_to_say_without_flights() -> None:
    empty = calibrate([], "m")
    assert empty.flights == 0
    assert empty.roc_area.value is None
    assert empty.metrics.f1.value is None
