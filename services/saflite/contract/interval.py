"""A figure and how far it can be trusted."""

from __future__ import annotations

import math
from statistics import NormalDist

import msgspec

Z95 = NormalDist().inv_cdf(0.975)


class Interval(msgspec.Struct, frozen=True, kw_only=True):
    """An estimate with its 95 % interval; all None where nothing can be said."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


def wilson(hits: int, count: int) -> Interval:
    """Return the share `hits` of `count` with its 95 % Wilson interval; nothing for an empty count."""
    if count == 0:
        return Interval()
    share, square = hits / count, Z95 * Z95 / count
    middle = (share + square / 2.0) / (1.0 + square)
    half = Z95 * math.sqrt(share * (1.0 - share) / count + square / (4.0 * count)) / (1.0 + square)
    low = 0.0 if hits == 0 else max(0.0, middle - half)  # exact at the ends, where rounding leaves a crumb
    high = 1.0 if hits == count else min(1.0, middle + half)
    return Interval(value=share, low=low, high=high)
