"""Every score meets its outcome: how far a model's scores can be trusted, with intervals and constant baselines.

The figures are those of the paper's table II (accuracy, precision, recall, F1), the area under the ROC curve, and the
reliability curve. Flights chosen by score are a biased sample (only what scored high was flown), so `of_random` picks
those drawn at random, which are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.interval import Interval, wilson
from saflite.contract.rng import derive
from saflite.contract.score import INTERESTING_ABOVE, SCORE_MAX

BANDS = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0)
BOOTSTRAPS = 400


class Row(NamedTuple):
    """One score and what came of it. `chosen` says whether the flight was chosen by score or at random."""

    model: str
    score: float
    violated: bool
    chosen: str = "score"


class Confusion(msgspec.Struct, frozen=True, kw_only=True):
    """Counts with "interesting" (score above the threshold) as the positive answer and a violation as the truth."""

    true_positive: int = 0
    false_positive: int = 0
    false_negative: int = 0
    true_negative: int = 0

    @property
    def count(self) -> int:
        """Number of pairs."""
        return self.true_positive + self.false_positive + self.false_negative + self.true_negative


class Metrics(msgspec.Struct, frozen=True, kw_only=True):
    """Table II of the paper for one model, with counts and Wilson intervals."""

    confusion: Confusion
    accuracy: Interval
    precision: Interval
    recall: Interval
    f1: Interval


class Band(msgspec.Struct, frozen=True, kw_only=True):
    """One step of the reliability curve: of `count` cases scored in [from, to) this share violated."""

    from_score: float
    to_score: float
    count: int
    mean_score: float | None
    violated: Interval


class Calibration(msgspec.Struct, frozen=True, kw_only=True):
    """How one model's scores met their outcomes, beside the two constant answers on the same flights."""

    model: str
    flights: int
    violations: int
    sample: str
    threshold: float
    metrics: Metrics
    roc_area: Interval
    reliability: tuple[Band, ...]
    always: Metrics
    never: Metrics


def roc_area(violated: NDArray[np.bool_], scores: NDArray[np.float64]) -> float | None:
    """Return the chance that a violating case scores above one that held, ties counted half; None without both."""
    positives = int(violated.sum())
    negatives = len(violated) - positives
    if positives == 0 or negatives == 0:
        return None
    from sklearn.metrics import roc_auc_score  # here, as it takes a second to load

    return float(roc_auc_score(violated, scores))


def confusion(predicted: NDArray[np.bool_], violated: NDArray[np.bool_]) -> Confusion:
    """Count the four cases of two Boolean arrays of equal shape (pairs,)."""
    if not len(violated):
        return Confusion()
    from sklearn.metrics import confusion_matrix

    (held, alarm), (missed, hit) = confusion_matrix(violated, predicted, labels=[False, True]).tolist()
    return Confusion(true_positive=hit, false_positive=alarm, false_negative=missed, true_negative=held)


def metrics(counts: Confusion) -> Metrics:
    """Return the paper's four figures of a confusion matrix, each with its interval."""
    hits = counts.true_positive
    return Metrics(
        confusion=counts,
        accuracy=wilson(hits + counts.true_negative, counts.count),
        precision=wilson(hits, hits + counts.false_positive),
        recall=wilson(hits, hits + counts.false_negative),
        f1=_f1(counts),
    )


def _f1(counts: Confusion) -> Interval:
    """Return the harmonic mean of precision and recall; nothing where there is neither a positive nor a violation.

    F1 is 2 J / (1 + J) with J the share of hits among all positives and violations (Jaccard), and so is its interval.
    """
    found = wilson(counts.true_positive, counts.true_positive + counts.false_positive + counts.false_negative)
    if found.value is None or found.low is None or found.high is None:
        return Interval()
    value, low, high = (2.0 * share / (1.0 + share) for share in (found.value, found.low, found.high))
    return Interval(value=value, low=low, high=high)


def roc_interval(violated: NDArray[np.bool_], scores: NDArray[np.float64], rng_seed: int = 0) -> Interval:
    """Return the ROC area with a bootstrap interval over the pairs (violating and held drawn apart)."""
    value = roc_area(violated, scores)
    if value is None:
        return Interval()
    from scipy.stats import bootstrap, mannwhitneyu

    def area(bad: NDArray[np.float64], good: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        above = mannwhitneyu(bad, good, axis=axis, method="asymptotic").statistic
        return np.asarray(above / (bad.shape[axis] * good.shape[axis]))

    parts = [np.repeat(part, 2) if len(part) == 1 else part for part in (scores[violated], scores[~violated])]
    rng = derive(rng_seed, "calibration", "roc", len(scores))
    found = bootstrap(parts, area, n_resamples=BOOTSTRAPS, vectorized=True, method="percentile", rng=rng)
    return Interval(value=value, low=float(found.confidence_interval.low), high=float(found.confidence_interval.high))


def reliability(scores: NDArray[np.float64], violated: NDArray[np.bool_]) -> tuple[Band, ...]:
    """Return the share of violations per band of two score points."""
    bands = []
    for low, high in pairwise(BANDS):
        inside = (scores >= low) & ((scores < high) | (high == SCORE_MAX))
        count = int(inside.sum())
        bands.append(
            Band(
                from_score=low,
                to_score=high,
                count=count,
                mean_score=float(scores[inside].mean()) if count else None,
                violated=wilson(int(violated[inside].sum()), count),
            )
        )
    return tuple(bands)


def calibrate(
    rows: Sequence[Row], model: str, *, threshold: float = INTERESTING_ABOVE, sample: str = "all"
) -> Calibration:
    """Return how the scores of `model` met their outcomes.

    Args:
        rows: scores with outcomes, of any models.
        model: whose rows to look at.
        threshold: scores above it count as "interesting".
        sample: `all`, or `random` for flights drawn at random only, whose figures selection does not bias.
    """
    mine = [row for row in rows if row.model == model and (sample == "all" or row.chosen == "random")]
    scores = np.array([row.score for row in mine], dtype=float)
    violated = np.array([row.violated for row in mine], dtype=bool)
    everything = np.ones(len(mine), dtype=bool)
    return Calibration(
        model=model,
        flights=len(mine),
        violations=int(violated.sum()),
        sample=sample,
        threshold=threshold,
        metrics=metrics(confusion(scores > threshold, violated)),
        roc_area=roc_interval(violated, scores),
        reliability=reliability(scores, violated),
        always=metrics(confusion(everything, violated)),
        never=metrics(confusion(~everything, violated)),
    )


def calibrate_all(rows: Sequence[Row], *, threshold: float = INTERESTING_ABOVE) -> tuple[Calibration, ...]:
    """Return for each model the figures on all its flights and on those drawn at random."""
    models = sorted({row.model for row in rows})
    return tuple(
        calibrate(rows, model, threshold=threshold, sample=sample) for model in models for sample in ("all", "random")
    )
