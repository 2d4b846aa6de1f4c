"""A figure and how far it can be trusted."""

from __future__ import annotations

import msgspec


class Interval(msgspec.Struct, frozen=True, kw_only=True):
    """An estimate with its 95 % interval; all None where nothing can be said."""

    value: float | None = None
    low: float | None = None
    high: float | None = None


def wilson(hits: int, count: int) -> Interval:
    """Return the share `hits` of `count` with its 95 % Wilson interval; nothing for an empty count."""
    if count == 0:
        return Interval()
    from scipy.stats import binomtest  # here, as it takes a second to load

    found = binomtest(hits, count).proportion_ci(0.95, method="wilson")
    return Interval(value=hits / count, low=float(found.low), high=float(found.high))
