"""Calibration against the paper's own table and values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.interval import wilson
from saflite.contract.rng import derive
from saflite.scorer_pool.calibration import (
    Confusion,
    Row,
    calibrate,
    calibrate_all,
    confusion,
    metrics,
    reliability,
    roc_area,
    roc_interval,
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


def test_roc_area_counts_pairs_and_half_of_the_ties() -> None:
    truth = np.array([True, True, False, False, False])
    # of the 6 pairs: 8 is above 5, 3 and 1; 5 ties with 5 and is above 3 and 1
    assert roc_area(truth, np.array([8.0, 5.0, 5.0, 3.0, 1.0])) == pytest.approx(5.5 / 6)
    assert roc_area(truth, np.zeros(5)) == 0.5
    assert roc_area(np.ones(3, dtype=bool), np.arange(3.0)) is None
    assert roc_area(np.zeros(0, dtype=bool), np.zeros(0)) is None


def test_interval_of_the_roc_area_covers_what_resampling_by_hand_gives() -> None:
    rng = derive(3, "roc interval")
    truth = rng.random(200) < 0.3
    scores = rng.normal(truth * 1.0, 1.0)
    got = roc_interval(truth, scores)
    bad, good = scores[truth], scores[~truth]
    areas = [(rng.choice(bad, len(bad))[:, None] > rng.choice(good, len(good))[None, :]).mean() for _ in range(1000)]
    low, high = np.quantile(areas, (0.025, 0.975))
    assert got.low == pytest.approx(low, abs=0.015)
    assert got.high == pytest.approx(high, abs=0.015)
    assert roc_interval(truth, scores) == got  # drawn from a named stream
    alone = roc_interval(np.array([True, False, False, False]), np.array([2.0, 1.0, 2.0, 3.0]))
    assert alone.value == pytest.approx(0.5)
    assert alone.low is not None
    assert alone.low < 0.5


def test_f1_of_known_case_and_its_interval_against_resampled_pairs() -> None:
    got = metrics(Confusion(true_positive=24, false_positive=10, false_negative=12, true_negative=24)).f1
    assert got.value == pytest.approx(48 / 70)
    drawn = derive(4, "f1").multinomial(70, np.array([24, 10, 12, 24]) / 70, size=4000)
    values = 2 * drawn[:, 0] / (2 * drawn[:, 0] + drawn[:, 1] + drawn[:, 2])
    low, high = np.quantile(values, (0.025, 0.975))
    assert got.low == pytest.approx(low, abs=0.02)
    assert got.high == pytest.approx(high, abs=0.02)
    assert metrics(Confusion(true_negative=3)).f1.value is None


def test_confusion_counts_each_pair_once() -> None:
    predicted, violated = np.array([True, True, False, False, True]), np.array([True, False, True, False, True])
    assert confusion(predicted, violated) == Confusion(
        true_positive=2, false_positive=1, false_negative=1, true_negative=1
    )
    assert confusion(np.zeros(0, dtype=bool), np.zeros(0, dtype=bool)) == Confusion()


def test_wilson_interval_of_known_case() -> None:
    got = wilson(48, 70)
    assert got.low == pytest.approx(0.5700, abs=5e-4)
    assert got.high == pytest.approx(0.7823, abs=5e-4)
    assert wilson(0, 0).value is None
    assert wilson(0, 5).low == 0.0
    assert wilson(5, 5).high == 1.0
    assert wilson(8, 10).low == pytest.approx(0.4902, abs=5e-5)  # (0.8 + 0.19207 - 0.31349) / 1.38415
    assert wilson(8, 10).high == pytest.approx(0.9433, abs=5e-5)


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
