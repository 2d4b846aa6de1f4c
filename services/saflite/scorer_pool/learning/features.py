"""Test cases as numbers, for models that learn or compare: layouts of boxes and sequences of stimuli."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Mission, Scenario, Stimulus, TestCase
from saflite.flight.geometry import boxes_array, distances_to_boxes
from saflite.flight.mission import Waypoint, places_of
from saflite.flight.planner.gap import box_gaps

BOXES_MAX = 4
PER_BOX = 9
LAYOUT_OWN = 6
LAYOUT_FEATURES = LAYOUT_OWN + BOXES_MAX * PER_BOX
STIMULUS_BUCKETS = 48
STIMULUS_FEATURES = 5 + 2 * STIMULUS_BUCKETS
FEATURES = LAYOUT_FEATURES + STIMULUS_FEATURES
FAR_M = 50.0
PATH_STEP_M = 0.5
PATH_POINTS_MAX = 100_000
"""A way longer than any vehicle flies has wider steps."""


Array = NDArray[np.float64]


def has_layout(test_case: TestCase) -> bool:
    """Return whether a vehicle flies a mission among obstacles here, so that geometry has something to say."""
    return test_case.scenario.mission is not None and bool(test_case.scenario.obstacles)


def path_points(mission: Mission) -> Array:
    """Return the straight way through the way-points, shape (points, 3) m, about half a metre apart; read-only."""
    return _path(places_of(mission))


@lru_cache(maxsize=64)
def _path(places: tuple[Waypoint, ...]) -> Array:
    corners = np.array([(0.0, 0.0, 0.0), *((place.x_m, place.y_m, place.z_m) for place in places)], dtype=float)
    pieces = []
    lengths_m = [float(np.linalg.norm(end - start)) for start, end in pairwise(corners)]
    step_m = max(PATH_STEP_M, sum(lengths_m) / PATH_POINTS_MAX)
    for (start, end), length_m in zip(pairwise(corners), lengths_m, strict=True):
        steps = max(1, math.ceil(length_m / step_m))
        pieces.append(start + (end - start) * np.linspace(0.0, 1.0, steps, endpoint=False)[:, None])
    path = np.concatenate([*pieces, corners[-1:]])
    path.setflags(write=False)
    return path


def features(test_cases: Sequence[TestCase]) -> Array:
    """Return test cases as vectors, shape (count, FEATURES); parts that do not apply are zero."""
    vectors = np.zeros((len(test_cases), FEATURES))
    by_way: dict[tuple[tuple[Waypoint, ...], int], list[int]] = {}
    for place, case in enumerate(test_cases):
        vectors[place, LAYOUT_FEATURES:] = stimulus_features(case.stimuli)
        if case.scenario.mission is not None and case.scenario.obstacles:
            key = (places_of(case.scenario.mission), len(case.scenario.obstacles))
            by_way.setdefault(key, []).append(place)
    for (way, _), places in by_way.items():
        scenarios = [test_cases[place].scenario for place in places]
        vectors[places, :LAYOUT_FEATURES] = _layouts(_path(way)[::2], scenarios)
    return vectors


def _layouts(path: Array, scenarios: Sequence[Scenario]) -> Array:
    """Return what boxes look like along one way, shape (layouts, LAYOUT_FEATURES), equally many boxes in each.

    The boxes stand in the order in which they are met; `path` has shape (points, 3).
    """
    boxes = boxes_array([box for scenario in scenarios for box in scenario.obstacles])
    near = distances_to_boxes(path, boxes).T  # (boxes, points)
    met, distance = near.argmin(axis=1), np.minimum(near.min(axis=1), FAR_M)
    cos, sin = boxes[:, 4], boxes[:, 5]
    sides = (2.0 * boxes[:, 2], 2.0 * boxes[:, 3], boxes[:, 7] - boxes[:, 6])
    turn = (cos**2 - sin**2, 2.0 * cos * sin)
    one = np.stack([boxes[:, 0], boxes[:, 1], *sides, *turn, met, distance], axis=1)
    count, layouts = len(scenarios[0].obstacles), len(scenarios)
    order = np.argsort(met.reshape(layouts, count), axis=1, kind="stable")
    sorted_ones = np.take_along_axis(one.reshape(layouts, count, PER_BOX), order[..., None], axis=1)
    closest = near.reshape(layouts, count, -1).min(axis=1)
    vectors = np.zeros((layouts, LAYOUT_FEATURES))
    vectors[:, 0] = count
    vectors[:, 1] = np.minimum(box_gaps(boxes.reshape(layouts, count, -1)), FAR_M)
    vectors[:, 2] = np.minimum(closest.min(axis=1), FAR_M)
    vectors[:, 3] = (closest < 2.0).mean(axis=1)
    vectors[:, 4] = (one[:, 2] * one[:, 3]).reshape(layouts, count).sum(axis=1)
    vectors[:, 5] = [scenario.wind.mean_mps + scenario.wind.gust_mps for scenario in scenarios]
    kept = sorted_ones[:, :BOXES_MAX].reshape(layouts, -1)
    vectors[:, LAYOUT_OWN : LAYOUT_OWN + kept.shape[1]] = kept
    return vectors


def stimulus_features(stimuli: tuple[Stimulus, ...]) -> Array:
    """Return which inputs are given and how large, shape (STIMULUS_FEATURES,); names are hashed into buckets."""
    vector = np.zeros(STIMULUS_FEATURES)
    kinds = {"parameter": 0, "command": 1, "stick": 2, "mode": 3, "sensor_fault": 4}
    for stimulus in stimuli:
        vector[kinds[stimulus.kind]] += 1.0
        bucket = 5 + 2 * (zlib.crc32(f"{stimulus.kind}:{stimulus.name}".encode()) % STIMULUS_BUCKETS)
        vector[bucket] += 1.0
        vector[bucket + 1] += sum(_squash(value) for value in stimulus.values)
    return vector


def _squash(value: float) -> float:
    """Return a value of any size on a scale trees and distances can use; not a number counts as 0."""
    if not math.isfinite(value):
        return 0.0
    return math.copysign(math.log1p(abs(value)), value)
