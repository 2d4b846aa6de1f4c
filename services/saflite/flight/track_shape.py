"""How far two tracks are apart in shape: time plays no part, detours do.

The UAV testing competition (SBFT 2024) calls two tests similar by dynamic time warping (Sakoe and Chiba 1978) between
their tracks; its limit is not published. Here tracks are points evenly spaced along the way, and the sum of gaps along
the best alignment is divided by its steps: metres, whatever the length of the flight and however long it hovered.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saflite.contract.bounds import Track

POINTS = 64
SAME_SHAPE_M = 5.0
"""Tracks no farther apart than this on average have one shape."""

TOGETHER = 64  # shapes looked at in one go: 2 MB of gaps
ROUNDING_M = 0.01  # of what gaps are at least: worked out from squares of coordinates

Shape = bytes
"""`POINTS` places (x, y) in the plane as little-endian doubles; empty without a track."""

Gaps = NDArray[np.float64]
"""(others, POINTS, POINTS): metres between each place of one shape and each of every other one."""


def shape_of(track: Track) -> Shape:
    """Return a track as points in the plane (x, y), evenly spaced along the way; empty without a track."""
    if not track:
        return b""
    places = np.array([point[1:3] for point in track], dtype=np.float64)
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T)))
    wanted = np.linspace(0.0, float(along[-1]), POINTS)
    columns = [np.round(np.interp(wanted, along, places[:, axis]), 3) for axis in (0, 1)]
    return np.stack(columns, axis=1).astype("<f8").tobytes()


def centre_of(shape: Shape) -> tuple[float, float]:
    """Return the mean place (x, y) of a shape that is not empty, in metres."""
    x, y = np.mean(np.frombuffer(shape, dtype="<f8").reshape(-1, 2), axis=0).tolist()
    return x, y


def gap_m(one: Shape, other: Shape) -> float:
    """Return the mean gap between two shapes along their best alignment; 0 where both are empty."""
    if not one or not other:
        return 0.0 if one == other else float("inf")
    return float(_aligned(_gaps(one, [other]))[0])


def first_like(shape: Shape, others: Sequence[Shape], limit_m: float = SAME_SHAPE_M) -> int | None:
    """Return the place of the first of the others that is no farther away than `limit_m`; None if all are."""
    for start in range(0, len(others), TOGETHER):
        some = others[start : start + TOGETHER]
        if not shape or not all(some):
            near = [place for place, other in enumerate(some) if gap_m(shape, other) <= limit_m]
        else:
            maybe = np.flatnonzero(_at_least(shape, some) <= limit_m + ROUNDING_M).tolist()
            gaps_m = _aligned(_gaps(shape, [some[place] for place in maybe])) if maybe else ()
            near = [place for place, gap in zip(maybe, gaps_m, strict=True) if gap <= limit_m]
        if near:
            return start + near[0]
    return None


def _places(*shapes: Shape) -> NDArray[np.float64]:
    return np.frombuffer(b"".join(shapes), "<f8").reshape(-1, POINTS, 2)


def _gaps(one: Shape, others: Sequence[Shape]) -> Gaps:
    ours, theirs = _places(one)[:, :, None], _places(*others)[:, None]
    return np.hypot(ours[..., 0] - theirs[..., 0], ours[..., 1] - theirs[..., 1])


def _at_least(one: Shape, others: Sequence[Shape]) -> NDArray[np.float64]:
    """Return what no alignment can fall below: it meets every place of both shapes, in `POINTS` steps or up to twice.

    Ten times as quick as the gaps themselves: roots are drawn of the least squares alone.
    """
    ours, theirs = _places(one)[0], _places(*others)
    squares = ours @ theirs.transpose(0, 2, 1)
    squares *= -2.0
    squares += (ours * ours).sum(axis=1)[:, None]
    squares += (theirs * theirs).sum(axis=2)[:, None, :]
    least = [np.sqrt(np.maximum(squares.min(axis=axis), 0.0)) for axis in (1, 2)]
    met_m = np.maximum(least[0].sum(axis=1), least[1].sum(axis=1))
    longest = 2 * POINTS - 1
    return np.asarray(np.minimum(met_m / POINTS, (met_m + (longest - POINTS) * least[0].min(axis=1)) / longest))


def _aligned(gaps: Gaps) -> NDArray[np.float64]:
    """Return the mean gap along the best alignment with each of the others: least in sum, of these least in steps.

    Diagonal by diagonal, for all others at once: a sum depends on those of the two diagonals before only. What stands
    at place i + 1 of a diagonal belongs to place i of our shape; outside the shapes sums are infinite.
    """
    turned = gaps[:, :, ::-1]
    before, last = np.full((2, len(gaps), POINTS + 1), np.inf)
    steps_before, steps_last = np.zeros((2, len(gaps), POINTS + 1), dtype=np.int64)
    for diagonal in range(2 * POINTS - 1):
        low, high = max(0, diagonal - POINTS + 1), min(diagonal, POINTS - 1) + 1
        here = np.diagonal(turned, POINTS - 1 - diagonal, axis1=1, axis2=2)
        sums, steps = np.full_like(last, np.inf), np.zeros_like(steps_last)
        if diagonal:
            ways = (before[:, low:high], last[:, low:high], last[:, low + 1 : high + 1])
            counts = (steps_before[:, low:high], steps_last[:, low:high], steps_last[:, low + 1 : high + 1])
            least = np.minimum(np.minimum(ways[0], ways[1]), ways[2])
            fewest = [np.where(way == least, count, 2 * POINTS) for way, count in zip(ways, counts, strict=True)]
            sums[:, low + 1 : high + 1] = least + here
            steps[:, low + 1 : high + 1] = np.minimum(np.minimum(fewest[0], fewest[1]), fewest[2]) + 1
        else:
            sums[:, 1:2], steps[:, 1:2] = here, 1
        before, last, steps_before, steps_last = last, sums, steps_last, steps
    return np.asarray(last[:, POINTS] / steps_last[:, POINTS])
