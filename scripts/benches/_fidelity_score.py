"""The numbers of the fidelity protocol, as pure functions over arrays."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

Array = NDArray[np.float64]
SAME_ROUTE_M, SAME_ROUTE_SHARE, AIRBORNE_M = 3.0, 0.98, 8.0


def rank_correlation(a: Array, b: Array) -> float:
    """Return Spearman's correlation; nan where one side does not vary."""
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return float(spearmanr(a, b).statistic)


def dense(track: Array, step_m: float = 0.25) -> Array:
    """Return the track's places (x, y, z) no further apart than about `step_m`."""
    pieces = []
    for start, end in itertools.pairwise(track):
        count = max(1, int(np.hypot(*(end[:2] - start[:2])) / step_m))
        pieces.append(start + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (end - start))
    return np.concatenate([*pieces, track[-1:]])


def off_route(real: Array, flown: Array) -> Array:
    """Return for each airborne place of the real track its distance in the plane to the flown one."""
    places, line = real[real[:, 2] > AIRBORNE_M, :2], dense(flown)[:, :2]
    return np.array([np.hypot(*(line - place).T).min() for place in places])


def same_route(distances: Array) -> bool:
    """Return whether 98 % of the real places lie within 3 m of the flown track."""
    return bool((distances <= SAME_ROUTE_M).mean() >= SAME_ROUTE_SHARE)


def clearances(track: Array, boxes: Array) -> Array:
    """Return the least competition distance of a track (x, y, z) to each box."""
    places = dense(track)
    dx, dy = places[:, 0, None] - boxes[:, 0], places[:, 1, None] - boxes[:, 1]
    along = np.abs(dx * boxes[:, 4] + dy * boxes[:, 5]) - boxes[:, 2]
    across = np.abs(dy * boxes[:, 4] - dx * boxes[:, 5]) - boxes[:, 3]
    flat = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    above = np.maximum(places[:, 2, None] - boxes[:, 7], 0.0)
    return np.asarray(np.where(flat == 0.0, above, flat).min(axis=0))


def within_tools(tools: list[str], real: Array, flown: Array, least: int = 8) -> float:
    """Return the rank correlation inside each tool with `least` flights or more, averaged by their number."""
    names, total, weight = np.array(tools), 0.0, 0
    for tool in sorted(set(tools)):
        chosen = names == tool
        correlation = rank_correlation(real[chosen], flown[chosen])
        if chosen.sum() >= least and np.isfinite(correlation):
            total += correlation * int(chosen.sum())
            weight += int(chosen.sum())
    return total / weight if weight else float("nan")
