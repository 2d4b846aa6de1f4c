"""How different a test case is from others: a distance in 0..1 between sets of obstacles and stimuli."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Obstacle, Stimulus, TestCase

REFERENCES_MAX = 256
"""With how many of the latest flown test cases a new one is compared; keeps a round's choice at a few milliseconds."""

_SIZE = 7


class Features(NamedTuple):
    """A test case as points: `points` (k, 7) float64, `labels` (k,) int64 telling what may be compared with what."""

    points: NDArray[np.float64]
    labels: NDArray[np.int64]


def features(test_case: TestCase) -> Features:
    """Return the points of a test case: one per obstacle and one per stimulus, one unit being a clear difference."""
    obstacles, stimuli = test_case.scenario.obstacles, test_case.stimuli
    rows = [_obstacle_point(obstacle) for obstacle in obstacles] + [_stimulus_point(stimulus) for stimulus in stimuli]
    labels = [0] * len(obstacles) + [zlib.crc32(f"{item.kind}:{item.name}".encode()) + 1 for item in stimuli]
    if not rows:
        rows, labels = [[0.0] * _SIZE], [-1]
    return Features(np.asarray(rows, dtype=np.float64), np.asarray(labels, dtype=np.int64))


def novelty(one: Features, others: Sequence[Features]) -> float:
    """Return the distance to the nearest of `others`, 0 (the same) to 1 (nothing in common, or nothing to compare)."""
    if not others:
        return 1.0
    points = np.concatenate([other.points for other in others])
    labels = np.concatenate([other.labels for other in others])
    starts = np.cumsum([0, *(len(other.labels) for other in others[:-1])])
    cost = np.sqrt(((one.points[:, None, :] - points[None, :, :]) ** 2).sum(axis=2))
    cost = np.where(one.labels[:, None] == labels[None, :], np.minimum(cost, 1.0), 1.0)
    there = np.minimum.reduceat(cost, starts, axis=1).mean(axis=0)
    counts = np.diff([*starts, len(labels)])
    back = np.add.reduceat(cost.min(axis=0), starts) / counts
    return float((0.5 * (there + back)).min())


def _obstacle_point(obstacle: Obstacle) -> list[float]:
    """Places count by 10 m, sizes by 20 m; a box turned by 180 degrees is the same box."""
    turn = math.radians(2.0 * obstacle.rotation_deg)
    longness = abs(obstacle.length_m - obstacle.width_m) / 20.0
    return [
        obstacle.x_m / 10.0,
        obstacle.y_m / 10.0,
        (obstacle.z_m + obstacle.height_m) / 50.0,
        obstacle.length_m / 20.0,
        obstacle.width_m / 20.0,
        longness * math.cos(turn),
        longness * math.sin(turn),
    ]


def _stimulus_point(stimulus: Stimulus) -> list[float]:
    """Times count by 30 s, values by their order of magnitude; the first six values are looked at."""
    values = [_squash(value) for value in stimulus.values[: _SIZE - 1]]
    return [stimulus.at_s / 30.0, *values, *([0.0] * (_SIZE - 1 - len(values)))]


def _squash(value: float) -> float:
    if not math.isfinite(value):
        return 4.0
    return math.copysign(math.log1p(abs(value)) / 2.0, value)
