"""The interval all benches give beside a figure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


def bootstrap_95(
    statistic: Callable[[NDArray[np.intp]], float], count: int, rng: np.random.Generator, draws: int = 2000
) -> tuple[float, float]:
    """Return the 95 % percentile interval of `statistic(indices)`, the indices drawn with replacement below `count`.

    Each index is one independent observation (a layout, a campaign, a stretch of time); NaN below two of them.
    Draws for which the statistic has no value (NaN: no failing layout among them, say) are left out.
    """
    if count < 2:
        return float("nan"), float("nan")
    drawn = rng.integers(0, count, (draws, count))
    found = np.array([statistic(indices) for indices in drawn], float)
    found = found[~np.isnan(found)]
    if not found.size:
        return float("nan"), float("nan")
    low, high = np.percentile(found, (2.5, 97.5))
    return float(low), float(high)
