"""How far two tracks are apart in shape: time plays no part, detours do.

The UAV testing competition (SBFT 2024) calls two tests similar by dynamic time warping between their tracks. Here the
warping takes the largest gap along the best alignment in place of the sum of gaps (the discrete Fréchet distance, Eiter
and Mannila 1994): metres, whatever the length of the flight and however long the vehicle hovered.
"""

from __future__ import annotations

import numpy as np

from saflite.contract.bounds import Track

POINTS = 64
SAME_SHAPE_M = 5.0
"""Tracks that stay within this of each other have one shape."""

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
    """Return the largest gap between two shapes along their best alignment; 0 where both are empty."""
    if not one or not other:
        return 0.0 if one == other else float("inf")
    ours, theirs = np.array(one)[:, None, :], np.array(other)[None, :, :]
    gaps = np.hypot(ours[:, :, 0] - theirs[:, :, 0], ours[:, :, 1] - theirs[:, :, 1]).tolist()
    best = gaps[0]
    for column in range(1, len(best)):
        best[column] = max(best[column], best[column - 1])
    for row in gaps[1:]:
        row[0] = max(row[0], best[0])
        for column in range(1, len(row)):
            row[column] = max(row[column], min(best[column], best[column - 1], row[column - 1]))
        best = row
    return float(best[-1])
