"""Two arms on the same tasks: difference, interval, test, effect size, and what could have been seen at that size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from _bootstrap import bootstrap_95
from scipy.stats import rankdata, wilcoxon

POWER_FACTOR = 1.96 + 0.84  # two-sided 5 %, power 80 %, normal


class Paired(NamedTuple):
    """`difference` is the mean of first minus second with its 95 % bootstrap interval; `p` by Wilcoxon's signed ranks.

    `effect` is the matched-pairs rank-biserial correlation (Kerby 2014), -1 to 1: the share of rank sums for the
    first less that for the second. `detectable` is the least mean difference that so many pairs of this spread would
    show with 80 % power. NaN where the pairs are too few to say.
    """

    pairs: int
    difference: float
    low: float
    high: float
    p: float
    effect: float
    detectable: float


def compare(first: Sequence[float], second: Sequence[float], rng: np.random.Generator) -> Paired:
    """Return the comparison of two arms, value by value on the same tasks."""
    differences = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    count = len(differences)
    if count < 2:
        nan = float("nan")
        return Paired(count, float(differences.mean()) if count else nan, nan, nan, nan, nan, nan)
    low, high = bootstrap_95(lambda index: float(differences[index].mean()), count, rng)
    moved = differences[differences != 0.0]
    ranks = rankdata(np.abs(moved))
    effect = float((np.sign(moved) * ranks).sum() / ranks.sum()) if len(moved) else 0.0
    p = float(wilcoxon(moved).pvalue) if len(moved) else 1.0
    detectable = POWER_FACTOR * float(differences.std(ddof=1)) / np.sqrt(count)
    return Paired(count, float(differences.mean()), low, high, p, effect, float(detectable))


def holm(values: Sequence[float]) -> list[float]:
    """Return p values corrected for their number (Holm 1979); NaN stays and counts for nothing."""
    known = sorted((value, place) for place, value in enumerate(values) if not np.isnan(value))
    corrected, largest = [float("nan")] * len(values), 0.0
    for rank, (value, place) in enumerate(known):
        largest = max(largest, min(1.0, value * (len(known) - rank)))
        corrected[place] = largest
    return corrected
