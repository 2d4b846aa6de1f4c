"""What holds at each moment, of changes and spans in time, in one look at all: a log may hold as many as samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def set_last(changes: Sequence[tuple[float, float]], before: Array, times: Array) -> Array:
    """Return what was set last at each moment, by changes in order of time, and until then `before`, shape (n,)."""
    at_s, values = np.array([(-np.inf, 0.0), *changes]).T
    number = np.searchsorted(at_s, times, side="right") - 1
    return np.where(number > 0, values[number], before).astype(before.dtype)


def within(spans: Sequence[tuple[float, float]], times: Array) -> NDArray[np.bool_]:
    """Return at which moments any of some spans of time lasts, shape (moments,): more have begun than are over."""
    begins_s, ends_s = np.array([(np.inf, np.inf), *spans]).T
    ends_s = np.maximum(begins_s, ends_s)
    begun, over = (np.searchsorted(np.sort(side), times, side="right") for side in (begins_s, ends_s))
    return np.asarray(begun > over)
