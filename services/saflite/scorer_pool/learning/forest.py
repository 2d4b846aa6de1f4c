"""Trees that learn from flights how near to a violation a test case comes; pure in its history.

Two questions are learnt apart: will a rule apply at all, and how near to a violation does a flight come in which one
did? A flight in which no rule applied answers the first only: it is no evidence that anything is safe, so it neither
trains the second nor its scale.
"""

from __future__ import annotations

from collections.abc import Sequence
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
SINGLE_MAX = float(np.finfo(np.float32).max)
APPLIED_MIN = 8
"""Flights in which a rule applied from which its danger is learnt; before, all that apply are taken for borderline."""
NEARNESS_WORTH = 0.5
"""What all but one of a rule's conditions at once are worth at most, a rule that applied being worth 1."""
GROWTH = 1.06
"""A new forest is grown when the history is this much longer (4 flights at least): learning stays a small share."""


class Forest(NamedTuple):
    """Trees grown on `flights` outcomes. `skill` is the ROC area on flights left out of each tree, None if unknown.

    `applies` is None where a rule applied in every flight, `dangers` where one applied in fewer than APPLIED_MIN.
    """

    applies: Any
    dangers: Any
    flights: int
    columns: NDArray[np.intp]
    skill: float | None

    def predict(self, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the expected danger 0..1 per row, shape (rows,): how surely a rule applies times how near it comes."""
        if not len(vectors):
            return np.zeros(0)
        rows = _rows(vectors, self.columns)
        applies = np.ones(len(rows)) if self.applies is None else self.applies.predict(rows)
        return np.asarray(applies * (0.5 if self.dangers is None else self.dangers.predict(rows)))


def telling(history: tuple[Outcome, ...]) -> list[Outcome]:
    """Return the outcomes that say something about the vehicle, those in which no rule applied among them."""
    return [outcome for outcome in history if outcome.guidance is not None]


def danger(margins: Sequence[float]) -> NDArray[np.float64]:
    """Return how near to a violation each margin is, 0 (far) to 1 (deep inside), 0.5 at the border.

    Robustness has the unit of the policy, so it is scaled by the median distance from the border seen so far.
    """
    values = np.array(margins, dtype=float)
    scale = max(float(np.median(np.abs(values))), 1e-9) / 1.5
    return 1.0 / (1.0 + np.exp(np.clip(values / scale, -30.0, 30.0)))


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
    kept = outcomes[-FLIGHTS_MAX:]
    matrix = vectors.of([outcome.test_case for outcome in kept])
    columns = np.flatnonzero(matrix.std(axis=0) > 1e-12)
    if not len(columns):
        columns = np.arange(1)
    rows = _rows(matrix, columns)
    applied = np.array([outcome.robustness is not None for outcome in kept])
    applies = None if applied.all() else _trees(rows, _applying(kept), derive_seed(0, "applies", len(outcomes)))
    dangers = None
    if int(applied.sum()) >= APPLIED_MIN:
        margins = [outcome.robustness for outcome in kept if outcome.robustness is not None]
        dangers = _trees(rows[applied], danger(margins), derive_seed(0, "forest", len(outcomes)))
    expected = np.ones(len(kept)) if applies is None else np.asarray(applies.oob_prediction_)
    expected = expected * _left_out(dangers, rows, applied)
    violated = np.array([bool(outcome.violated) for outcome in kept])
    return Forest(applies, dangers, len(outcomes), columns, roc_area(violated, expected))


def _rows(vectors: NDArray[np.float64], columns: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return the columns in single precision, as trees read them; what it cannot hold counts as its largest."""
    return np.ascontiguousarray(np.clip(vectors[:, columns], -SINGLE_MAX, SINGLE_MAX), dtype=np.float32)


def _applying(outcomes: list[Outcome]) -> NDArray[np.float64]:
    """Return 1 for each flight in which a rule applied, less for the others: the more, the nearer one came to it."""
    return np.array(
        [1.0 if one.robustness is not None else NEARNESS_WORTH * (one.nearness or 0.0) for one in outcomes], dtype=float
    )


def _trees(rows: NDArray[np.float32], target: NDArray[np.float64], rng_seed: int) -> Any:
    from sklearn.ensemble import ExtraTreesRegressor

    trees = ExtraTreesRegressor(
        n_estimators=TREES,
        min_samples_leaf=2,
        max_features=0.5,
        bootstrap=True,
        oob_score=True,
        random_state=rng_seed % 2**32,
        n_jobs=1,
    )
    return trees.fit(rows, target)


def _left_out(dangers: Any, rows: NDArray[np.float32], applied: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the danger of each flight as the trees that were not grown on it expect it, shape (rows,)."""
    expected = np.full(len(rows), 0.5)
    if dangers is not None:
        expected[applied] = dangers.oob_prediction_
        if not applied.all():
            expected[~applied] = dangers.predict(rows[~applied])
    return expected
