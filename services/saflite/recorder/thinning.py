"""Which samples of signals to write, so that a line drawn between them misses none by more than a tolerance.

Between samples kept at a steady rate the one furthest from the line is added until none is too far (Douglas and
Peucker 1973, over all signals at once). Steady flight needs little, a jerk or a jump keeps every sample it has.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

_FAR = 1e9
"""Stands for what is no number: further from all numbers than any tolerance."""


def on_a_line(values: NDArray[np.float64], tolerance: NDArray[np.float64], steady: int) -> NDArray[np.intp]:
    """Return the indices of the samples to write, ascending: every `steady`th, the last, what their line misses.

    Args:
        values: shape (samples, signals), evenly spaced in time.
        tolerance: shape (signals,), above 0: how far a signal may be from the line, in its unit.
        steady: number of samples between those that are always written.
    """
    scaled = np.clip(np.nan_to_num(values / tolerance, nan=_FAR, posinf=2 * _FAR, neginf=-_FAR), -_FAR, 2 * _FAR)
    kept = np.zeros(len(values), dtype=bool)
    kept[::steady] = kept[-1:] = True
    anchors = np.flatnonzero(kept).tolist()
    spans = list(pairwise(anchors))
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        share = np.arange(1, last - first)[:, None] / (last - first)
        line = scaled[first] + share * (scaled[last] - scaled[first])
        error = np.abs(scaled[first + 1 : last] - line).max(axis=1)
        furthest = int(error.argmax())
        if error[furthest] > 1.0:
            middle = first + 1 + furthest
            kept[middle] = True
            spans += [(first, middle), (middle, last)]
    return np.flatnonzero(kept)
