"""The interval all benches give beside a figure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap


def bootstrap_95(
    statistic: Callable[[NDArray[np.intp]], float], count: int, rng: np.random.Generator, draws: int = 2000
) -> tuple[float, float]:
    """Return the 95 % percentile interval of `statistic(indices)`, the indices drawn with replacement below `count`.

    Each index is one independent observation (a layout, a campaign, a stretch of time); NaN below two of them.
    """
    if count < 2:
        return float("nan"), float("nan")
    found = bootstrap(
        (np.arange(count),), statistic, n_resamples=draws, vectorized=False, method="percentile", rng=rng
    ).confidence_interval
    return float(found.low), float(found.high)
