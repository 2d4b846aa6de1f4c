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


def distances(ones: Sequence[Features], others: Sequence[Features]) -> NDArray[np.float64]:
    """Return how far each of `ones` is from each of `others`, shape (ones, others), 0 (the same) to 1.

    The mean over the points of one of the distance to the nearest point of the other, both ways, halved.
    """
    if not ones or not others:
        return np.ones((len(ones), len(others)))
    points, labels, starts, counts = _joined(ones)
    their_points, their_labels, their_starts, their_counts = _joined(others)
    cost = np.zeros((len(labels), len(their_labels)))
    apart = np.empty_like(cost)
    for axis in range(_SIZE):  # no matrix product: its last bits differ from machine to machine
        np.subtract(points[:, axis, None], their_points[None, :, axis], out=apart)
        cost += np.square(apart, out=apart)
    np.minimum(np.sqrt(cost, out=cost), 1.0, out=cost)
    cost[labels[:, None] != their_labels[None, :]] = 1.0
    there = np.add.reduceat(np.minimum.reduceat(cost, their_starts, axis=1), starts, axis=0) / counts[:, None]
    back = np.add.reduceat(np.minimum.reduceat(cost, starts, axis=0), their_starts, axis=1) / their_counts[None, :]
    return np.asarray(0.5 * (there + back))


def nearest(ones: Sequence[Features], others: Sequence[Features]) -> NDArray[np.float64]:
    """Return how far each of `ones` is from the nearest of `others`, shape (ones,), 0..1; 1 where there are none."""
    return np.asarray(distances(ones, others).min(axis=1, initial=1.0))


def _joined(
    many: Sequence[Features],
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    counts = np.asarray([len(one.labels) for one in many], dtype=np.int64)
    starts = np.cumsum(counts) - counts
    return np.concatenate([one.points for one in many]), np.concatenate([one.labels for one in many]), starts, counts


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
