"""Extremes over sliding windows of samples, in numpy.

A window that sticks out of the trace is cut; an empty one gives plus infinity for the least and minus infinity for the
greatest value, which is what rtamt gives.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def top(values: NDArray[Any]) -> Any:
    """Return what is above all values of their type: infinity, or of crisp ones (bytes) true, which is 1."""
    return np.int8(1) if values.dtype == np.int8 else np.inf


def least_ahead(values: Array, low: int, high: int | None) -> Array:
    """Return at each i the least of values[i+low .. i+high] (to the end where `high` is None), shape (n,)."""
    n = len(values)
    if low >= n:
        return np.full(n, top(values))
    if high is None or low + n - 1 <= high:
        ahead = np.minimum.accumulate(values[::-1])[::-1]
    else:
        ahead = _least_of_next(values, high - low + 1)
    return ahead if low == 0 else np.concatenate([ahead[low:], np.full(low, top(values))])


def _least_of_next(values: Array, width: int) -> Array:
    """Least of the next `width` samples, itself included: windows are doubled until two of them cover the width."""
    n = len(values)
    out = np.concatenate([values, np.full(width - 1, top(values))])
    have = 1
    while have * 2 <= width:
        out[: len(out) - have] = np.minimum(out[: len(out) - have], out[have:])
        have *= 2
    rest = width - have
    return np.minimum(out[:n], out[rest : rest + n]) if rest else out[:n]


def greatest_ahead(values: Array, low: int, high: int | None) -> Array:
    """Return at each i the greatest of values[i+low .. i+high], shape (n,)."""
    return -least_ahead(-values, low, high)


def least_behind(values: Array, low: int, high: int | None) -> Array:
    """Return at each i the least of values[i-high .. i-low], shape (n,)."""
    return least_ahead(values[::-1], low, high)[::-1]


def greatest_behind(values: Array, low: int, high: int | None) -> Array:
    """Return at each i the greatest of values[i-high .. i-low], shape (n,)."""
    return -least_behind(-values, low, high)


def until(left: Array, right: Array, low: int, high: int | None) -> Array:
    """Return the robustness of `left until[low:high] right` at each sample, shape (n,).

    At i: the greatest over j in i+low .. i+high of min(right[j], least of left[i .. j-1]).
    """
    if high is None:
        return _until_from(left, right, low)
    n = len(left)
    if low >= n or high < low:
        return np.full(n, -np.inf)
    out = _until_within(left, right, min(high, n - 1) - low + 1)
    if low == 0:
        return out
    kept = least_ahead(left, 0, low - 1)
    return np.concatenate([np.minimum(kept[: n - low], out[low:]), np.full(low, -np.inf)])


def _until_within(left: Array, right: Array, width: int) -> Array:
    """Return `left until right` where right comes with one of the next `width` samples, this one included.

    Windows are doubled, as in `_least_of_next`: what is reached in two after each other is reached in the first, or in
    the second while left holds through the first. To go through the samples of a window takes their square.
    """
    n, have = len(left), 1
    out, kept = right.copy(), left.copy()
    while have * 2 <= width:
        out[: n - have] = np.maximum(out[: n - have], np.minimum(kept[: n - have], out[have:]))
        kept[: n - have] = np.minimum(kept[: n - have], kept[have:])
        have *= 2
    rest = width - have
    if rest:
        through = _least_of_next(left, rest)[: n - rest]
        out[: n - rest] = np.maximum(out[: n - rest], np.minimum(through, out[rest:]))
    return out


def _until_from(left: Array, right: Array, low: int) -> Array:
    out = _until_any(left, right)
    if low == 0:
        return out
    shifted = np.concatenate([out[low:], np.full(min(low, len(out)), -np.inf)])[: len(out)]
    return np.asarray(np.minimum(shifted, least_ahead(left, 0, low - 1)))


def _until_any(left: Array, right: Array) -> Array:
    """Return `left until right`, whenever: at i the greater of right[i] and the lesser of left[i] and what follows."""
    if np.isnan(left).any() or np.isnan(right).any():
        out, later = np.empty(len(left)), -np.inf
        for i in range(len(left) - 1, -1, -1):
            later = max(right[i], min(left[i], later))  # forgets a gap once something is known again
            out[i] = later
        return out
    low, high, ahead = right.copy(), left.copy(), 1  # of all steps up to i + ahead: x becomes max(low, min(high, x))
    while ahead < len(left):
        low[:-ahead] = np.maximum(low[:-ahead], np.minimum(high[:-ahead], low[ahead:]))
        high[:-ahead] = np.minimum(high[:-ahead], high[ahead:])
        ahead *= 2
    return low


def since(left: Array, right: Array, low: int, high: int | None) -> Array:
    """Return the robustness of `left since[low:high] right`: `until` with time turned round, shape (n,)."""
    return until(left[::-1], right[::-1], low, high)[::-1]
