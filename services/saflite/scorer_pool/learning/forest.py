"""A forest of trees that learns from flights how near to a violation a test case comes; pure in its history."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.rng import derive_seed
from saflite.contract.work import Outcome
from saflite.scorer_pool.calibration import roc_area
from saflite.scorer_pool.learning.vectors import Vectors

TREES = 60
FLIGHTS_MIN = 16
FLIGHTS_MAX = 2_000
GROWTH = 1.06
"""A new forest is grown when the history is this much longer (4 flights at least): learning stays a small share."""


class Forest(NamedTuple):
    """Trees grown on `flights` outcomes. `skill` is the ROC area on flights left out of each tree, None if unknown."""

    trees: Any
    flights: int
    columns: NDArray[np.intp]
    skill: float | None

    def predict(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the expected danger 0..1 per row, shape (rows,)."""
        if not len(vectors):
            return np.zeros(0)
        return np.asarray(self.trees.predict(np.ascontiguousarray(vectors[:, self.columns], dtype=np.float32)))


def telling(history: tuple[Outcome, ...]) -> list[Outcome]:
    """Return the outcomes that say something about the vehicle."""
    return [outcome for outcome in history if outcome.robustness is not None]


def danger(outcomes: list[Outcome]) -> NDArray[np.float64]:
    """Return how near to a violation each flight came, 0 (far) to 1 (deep inside), 0.5 at the border.

    Robustness has the unit of the policy, so it is scaled by the median distance from the border seen so far.
    """
    robustness = np.array([outcome.robustness for outcome in outcomes], dtype=float)
    scale = max(float(np.median(np.abs(robustness))), 1e-9) / 1.5
    return 1.0 / (1.0 + np.exp(np.clip(robustness / scale, -30.0, 30.0)))


def step_size(count: int) -> int:
    """Return the length of history a forest is grown on when `count` outcomes are known."""
    size = FLIGHTS_MIN
    while (following := max(size + 4, int(size * GROWTH))) <= count:
        size = following
    return size


def grow(outcomes: list[Outcome], vectors: Vectors) -> Forest:
    """Return a forest grown on the latest 2,000 of the outcomes; the same for the same outcomes.

    Takes under a second at 2,000 flights on one core (`scripts/bench scoring`).
    """
    from sklearn.ensemble import ExtraTreesRegressor

    kept = outcomes[-FLIGHTS_MAX:]
    matrix = vectors.of([outcome.test_case for outcome in kept])
    columns = np.flatnonzero(matrix.std(axis=0) > 1e-12)
    if not len(columns):
        columns = np.arange(1)
    target = danger(kept)
    trees = ExtraTreesRegressor(
        n_estimators=TREES,
        min_samples_leaf=2,
        max_features=0.5,
        bootstrap=True,
        oob_score=True,
        random_state=derive_seed(0, "forest", len(outcomes)) % 2**32,
        n_jobs=1,
    )
    trees.fit(matrix[:, columns].astype(np.float32), target)
    violated = np.array([bool(outcome.violated) for outcome in kept])
    return Forest(trees, len(outcomes), columns, roc_area(violated, np.asarray(trees.oob_prediction_)))
