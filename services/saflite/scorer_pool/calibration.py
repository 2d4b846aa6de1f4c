"""Every score meets its outcome: how far a model's scores can be trusted, with intervals and constant baselines.

The figures are those of the paper's table II (accuracy, precision, recall, F1), the area under the ROC curve, and the
reliability curve. Flights chosen by score are a biased sample (only what scored high was flown), so `of_random` picks
those drawn at random, which are not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.rng import derive
from saflite.contract.score import INTERESTING_ABOVE, SCORE_MAX

Z95 = 1.959963984540054
BANDS = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0)
BOOTSTRAPS = 400


class Row(NamedTuple):
    """One score and what came of it. `chosen` says whether the flight was chosen by score or at random."""

    model: str
    score: float
    violated: bool
    chosen: str = "score"


class Interval(msgspec.Struct, frozen=True, kw_only=True):
    """An estimate with its 95 % interval; all None where nothing can be said."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


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
    """Table II of the paper for one model, with counts and Wilson (F1: bootstrap) intervals."""

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


def wilson(hits: int, count: int) -> Interval:
    """Return a share with its 95 % Wilson interval; nothing for an empty count."""
    if count == 0:
        return Interval()
    share, square = hits / count, Z95**2
    middle = (share + square / (2 * count)) / (1 + square / count)
    half = Z95 * math.sqrt(share * (1 - share) / count + square / (4 * count**2)) / (1 + square / count)
    return Interval(value=share, low=max(0.0, middle - half), high=min(1.0, middle + half))


def roc_area(violated: NDArray[np.bool_], scores: NDArray[np.float64]) -> float | None:
    """Return the chance that a violating case scores above one that held, ties counted half; None without both."""
    positives = int(violated.sum())
    negatives = len(violated) - positives
    if positives == 0 or negatives == 0:
        return None
    _, inverse, counts = np.unique(scores, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    ranks = (ends - (counts - 1) / 2.0)[inverse]
    return float((ranks[violated].sum() - positives * (positives + 1) / 2.0) / (positives * negatives))


def confusion(predicted: NDArray[np.bool_], violated: NDArray[np.bool_]) -> Confusion:
    """Count the four cases of two Boolean arrays of equal shape (pairs,)."""
    return Confusion(
        true_positive=int((predicted & violated).sum()),
        false_positive=int((predicted & ~violated).sum()),
        false_negative=int((~predicted & violated).sum()),
        true_negative=int((~predicted & ~violated).sum()),
    )


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


def f1_score(counts: Confusion) -> float | None:
    """Return the harmonic mean of precision and recall, None where there is neither a positive nor a violation."""
    total = 2 * counts.true_positive + counts.false_positive + counts.false_negative
    return 2 * counts.true_positive / total if total else None


def _f1(counts: Confusion) -> Interval:
    value = f1_score(counts)
    if value is None:
        return Interval()
    cells = (counts.true_positive, counts.false_positive, counts.false_negative, counts.true_negative)
    drawn = derive(counts.count, "calibration", "f1", *cells).multinomial(
        counts.count, np.array(cells) / counts.count, size=BOOTSTRAPS
    )
    denominator = 2 * drawn[:, 0] + drawn[:, 1] + drawn[:, 2]
    values = 2 * drawn[:, 0] / np.maximum(1, denominator)
    low, high = np.quantile(values, (0.025, 0.975))
    return Interval(value=value, low=float(low), high=float(high))


def roc_interval(violated: NDArray[np.bool_], scores: NDArray[np.float64], rng_seed: int = 0) -> Interval:
    """Return the ROC area with a bootstrap interval over the pairs (violating and held drawn apart)."""
    value = roc_area(violated, scores)
    if value is None:
        return Interval()
    rng = derive(rng_seed, "calibration", "roc", len(scores))
    bad, good = scores[violated], scores[~violated]
    truth = np.r_[np.ones(len(bad), dtype=bool), np.zeros(len(good), dtype=bool)]
    areas = [
        roc_area(truth, np.r_[rng.choice(bad, len(bad)), rng.choice(good, len(good))]) or 0.0 for _ in range(BOOTSTRAPS)
    ]
    low, high = np.quantile(areas, (0.025, 0.975))
    return Interval(value=value, low=float(low), high=float(high))


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
