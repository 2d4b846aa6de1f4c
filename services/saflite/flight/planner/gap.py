"""How tight a layout is, by geometry alone: no flight, thousands of layouts a second.

The gap between the boxes predicts failing avoidance flights about as well as a cheap simulation does (a trial: area
0.84 against 0.79 on 266 real simulations), and best together with it. All lengths in metres; boxes as
`flight.geometry.boxes_array` packs them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NO_GAP_M = 1000.0
Array = NDArray[np.float64]


def _corners(boxes: Array) -> Array:
    """Return the corners in order around, (..., 4, 2)."""
    along = boxes[..., None, 2] * np.array([1.0, -1.0, -1.0, 1.0])
    across = boxes[..., None, 3] * np.array([1.0, 1.0, -1.0, -1.0])
    cos, sin = boxes[..., None, 4], boxes[..., None, 5]
    return np.stack(
        [boxes[..., None, 0] + along * cos - across * sin, boxes[..., None, 1] + along * sin + across * cos], axis=-1
    )


def _to_box(points: Array, box: Array) -> Array:
    """Return distances of `points` (..., p, 2) to `box` (..., 8): (..., p), 0 inside."""
    dx, dy = points[..., 0] - box[..., None, 0], points[..., 1] - box[..., None, 1]
    cos, sin = box[..., None, 4], box[..., None, 5]
    along = np.maximum(np.abs(dx * cos + dy * sin) - box[..., None, 2], 0.0)
    across = np.maximum(np.abs(dy * cos - dx * sin) - box[..., None, 3], 0.0)
    distance: Array = np.hypot(along, across)
    return distance


def box_gaps(boxes: Array) -> Array:
    """Return the least distance between two boxes of each layout: (n, k, 8) -> (n,), 1000 where k is below 2.

    Exact for boxes that do not overlap: two convex shapes are nearest at a corner of one of them.
    """
    layouts, count = boxes.shape[0], boxes.shape[1]
    corners, least = _corners(boxes), np.full(layouts, NO_GAP_M)
    for i in range(count):
        for j in range(count):
            if i != j:
                least = np.minimum(least, _to_box(corners[:, i], boxes[:, j]).min(axis=-1))
    return least
