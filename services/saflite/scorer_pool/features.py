"""Test cases as numbers, for models that learn or compare: layouts of boxes and sequences of stimuli."""

from __future__ import annotations

import math
import zlib
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Mission, Obstacle, Scenario, Stimulus, TestCase
from saflite.flight.geometry import boxes_array, distances_to_boxes, gap
from saflite.flight.mission import Waypoint, waypoints

BOXES_MAX = 4
PER_BOX = 9
LAYOUT_FEATURES = 7 + BOXES_MAX * PER_BOX
STIMULUS_BUCKETS = 48
STIMULUS_FEATURES = 5 + 2 * STIMULUS_BUCKETS
FEATURES = LAYOUT_FEATURES + STIMULUS_FEATURES
FAR_M = 50.0
PATH_STEP_M = 0.5


def has_layout(test_case: TestCase) -> bool:
    """Return whether a vehicle flies a mission among obstacles here, so that geometry has something to say."""
    return test_case.scenario.mission is not None and bool(test_case.scenario.obstacles)


def path_points(mission: Mission) -> NDArray[np.float64]:
    """Return the straight way through the way-points, shape (points, 3) m, about half a metre apart; read-only."""
    return _path(waypoints(mission))


@lru_cache(maxsize=64)
def _path(places: tuple[Waypoint, ...]) -> NDArray[np.float64]:
    corners = np.array([(0.0, 0.0, 0.0), *((place.x_m, place.y_m, place.z_m) for place in places)], dtype=float)
    pieces = []
    for start, end in pairwise(corners):
        steps = max(1, math.ceil(float(np.linalg.norm(end - start)) / PATH_STEP_M))
        pieces.append(start + (end - start) * np.linspace(0.0, 1.0, steps, endpoint=False)[:, None])
    path = np.concatenate([*pieces, corners[-1:]])
    path.setflags(write=False)
    return path


def features(test_case: TestCase) -> NDArray[np.float64]:
    """Return the test case as a vector, shape (FEATURES,); parts that do not apply are zero."""
    return np.concatenate([layout_features(test_case.scenario), stimulus_features(test_case.stimuli)])


def layout_features(scenario: Scenario) -> NDArray[np.float64]:
    """Return what the boxes look like along the mission, shape (LAYOUT_FEATURES,); boxes in the order they are met."""
    vector = np.zeros(LAYOUT_FEATURES)
    mission, boxes = scenario.mission, scenario.obstacles
    if mission is None or not boxes:
        return vector
    path = path_points(mission)
    near = distances_to_boxes(path, boxes_array(boxes)).T
    order = np.argsort(near.argmin(axis=1), kind="stable")
    gaps = [gap(a, b) for place, a in enumerate(boxes) for b in boxes[:place]]
    closest = np.minimum(near.min(axis=0), FAR_M)
    vector[:7] = (
        len(boxes),
        min(gaps, default=FAR_M),
        float(np.median(gaps)) if gaps else FAR_M,
        float(closest.min()),
        float((closest < 2.0).mean()),
        sum(box.length_m * box.width_m for box in boxes),
        scenario.wind.mean_mps + scenario.wind.gust_mps,
    )
    for slot, place in enumerate(order[:BOXES_MAX]):
        start = 7 + slot * PER_BOX
        vector[start : start + PER_BOX] = _box_features(boxes[place], near[place])
    return vector


def _box_features(box: Obstacle, near_m: NDArray[np.float64]) -> tuple[float, ...]:
    turn = math.radians(2.0 * box.rotation_deg)
    place = int(near_m.argmin())
    return (
        box.x_m,
        box.y_m,
        box.length_m,
        box.width_m,
        box.height_m,
        math.cos(turn),
        math.sin(turn),
        place * PATH_STEP_M,
        min(float(near_m[place]), FAR_M),
    )


def stimulus_features(stimuli: tuple[Stimulus, ...]) -> NDArray[np.float64]:
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
