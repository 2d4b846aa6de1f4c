"""How far two tracks are apart in shape: time plays no part, detours do.

The UAV testing competition (SBFT 2024) calls two tests similar by dynamic time warping (Sakoe and Chiba 1978) between
their tracks; its limit is not published. Here tracks are points evenly spaced along the way, and the sum of gaps along
the best alignment is divided by its steps: metres, whatever the length of the flight and however long it hovered.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from saflite.contract.bounds import Track

POINTS = 64
SAME_SHAPE_M = 5.0
"""Tracks no farther apart than this on average have one shape."""

Shape = tuple[tuple[float, float], ...]


def shape_of(track: Track) -> Shape:
    """Return a track as points in the plane (x, y), evenly spaced along the way; empty without a track."""
    if not track:
        return ()
    places = np.array([point[1:3] for point in track], dtype=np.float64)
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T)))
    wanted = np.linspace(0.0, float(along[-1]), POINTS)
    rows = [np.round(np.interp(wanted, along, places[:, axis]), 3).tolist() for axis in (0, 1)]
    return tuple(zip(*rows, strict=True))


def gap_m(one: Shape, other: Shape) -> float:
    """Return the mean gap between two shapes along their best alignment; 0 where both are empty."""
    if not one or not other:
        return 0.0 if one == other else float("inf")
    ours, theirs = np.array(one)[:, None, :], np.array(other)[None, :, :]
    gaps = np.hypot(ours[:, :, 0] - theirs[:, :, 0], ours[:, :, 1] - theirs[:, :, 1]).tolist()
    row = [(total, steps) for steps, total in enumerate(accumulate(gaps[0]), 1)]
    for here in gaps[1:]:
        below, row = row, [(row[0][0] + here[0], row[0][1] + 1)]
        for column in range(1, len(here)):
            total, steps = min(below[column - 1], below[column], row[column - 1])
            row.append((total + here[column], steps + 1))
    total, steps = row[-1]
    return float(total / steps)
