"""Flies the mission on a kinematic vehicle with the real planner, where a first look says that it is worth it.

The look is geometry, more than 1,000 test cases a second; what looks safe beyond doubt is not flown. A flight costs a
fifteenth of a real one, except where the vehicle gets stuck: there it is given up.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from functools import lru_cache

import numpy as np

from saflite.contract.rng import derive_seed
from saflite.contract.score import SCORE_MAX
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Obstacle, TestCase, draw_key, identity
from saflite.flight.geometry import boxes_array, distances_to_boxes
from saflite.flight.mission import Waypoint, waypoints
from saflite.flight.passing import passing_of
from saflite.flight.planner.kinematic import KinematicFlight, KinematicSettings, fly_kinematic
from saflite.flight.planner.settings import VehicleSettings
from saflite.flight.track_shape import centre_of, shape_of
from saflite.scorer_pool.geometry_score import Look, look
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.features import has_layout
from saflite.scorer_pool.model import MIDDLE, Job, ModelScore, ScoreSheet, Tools

WORTH_FLYING = 0.5
"""Geometry score from which a kinematic flight is spent on a test case: none of 58 violating layouts was below."""

LATE = 1.75
"""So many times as long as without obstacles a kinematic flight may last; what is not there then is stuck or lost."""

LATE_WORTH = 0.25
"""What such a test case is worth: its real flight costs four times as much and violated as seldom as any other."""

EXPECTED_M = 2.0
"""Below it a behaviour is expected; closer flights of the kind are worth more."""

SAFE_M, SLOPE_M = 1.53, 0.215
"""Logistic fit of violations in 252 real flights among random boxes on missions 2 and 3 to the kinematic distance."""

DEPTH_SHARE = 0.2
"""Of the score is left for how deep a violation is to be."""

CELL_M = 8.0
"""Ways whose centres lie in one square of this size are taken for one shape."""

KEPT_MAX = 10_000
_ONE_AT_A_TIME = threading.Lock()
"""The compiled planner works in one block of memory per process."""


class Model:
    """Scores by the least distance of cheap flights; by geometry, below 0.5, where none was spent."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("low_fidelity", argument)
        self.label = "low_fidelity"
        self._kept: OrderedDict[str, ModelScore] = OrderedDict()
        self._lock = threading.Lock()

    def score(self, job: Job) -> ScoreSheet:
        """Return one score per test case; stops early, with the middle for the rest, once cancelled."""
        return ScoreSheet(tuple(self._mark(case, job) for case in job.test_cases), digest="low_fidelity-4")

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""

    def _mark(self, test_case: TestCase, job: Job) -> ModelScore:
        if not has_layout(test_case):
            return ModelScore(MIDDLE, "no mission among obstacles: nothing to fly cheaply")
        seen = look(test_case.scenario)
        if seen.score < WORTH_FLYING:
            return _unflown(seen)
        if job.cancelled():
            return ModelScore(MIDDLE, "cancelled")
        name = identity(test_case)
        with self._lock:
            if name in self._kept:
                return self._kept[name]
        score = _flown(test_case)
        with self._lock:
            self._kept[name] = score
            if len(self._kept) > KEPT_MAX:
                self._kept.popitem(last=False)
        return score


def _flown(test_case: TestCase) -> ModelScore:
    flight = _fly(test_case, 0)
    value, came_m = _danger(flight.min_distance_m), flight.min_distance_m
    kind = _kind(test_case, flight) if came_m < EXPECTED_M else ""
    if flight.ending == "timed_out":
        reason = f"came within {came_m:.2f} m and was not there after {flight.duration_s:.0f} s"
        return ModelScore(SCORE_MAX * LATE_WORTH * value, reason, kind=kind)
    return ModelScore(SCORE_MAX * value, f"came within {came_m:.2f} m in {flight.duration_s:.0f} s", kind=kind)


def _fly(test_case: TestCase, number: int) -> KinematicFlight:
    """Fly once; the noise depends on the test case and the number only, so a score is the same in every batch."""
    mission = test_case.scenario.mission
    assert mission is not None
    way = waypoints(mission)
    seed = derive_seed(test_case.rng_seed, "low_fidelity", draw_key(test_case), number)
    return _flight(way, test_case.scenario.obstacles, seed, min(VehicleSettings().time_limit_s, LATE * _alone_s(way)))


@lru_cache(maxsize=64)
def _alone_s(way: tuple[Waypoint, ...]) -> float:
    """Return how long a kinematic flight takes where nothing stands."""
    return _flight(way, (), 0, VehicleSettings().time_limit_s).duration_s


def _flight(way: tuple[Waypoint, ...], boxes: tuple[Obstacle, ...], rng_seed: int, limit_s: float) -> KinematicFlight:
    points = np.array([(place.x_m, place.y_m, place.z_m) for place in way], dtype=np.float64)
    settings = KinematicSettings(vehicle=VehicleSettings(time_limit_s=limit_s))
    with _ONE_AT_A_TIME:
        return fly_kinematic(points, boxes_array(boxes), rng_seed=rng_seed, settings=settings)


def _kind(test_case: TestCase, flight: KinematicFlight) -> str:
    """Return how the nearest obstacle was passed, as the oracle says it, and about where the way led."""
    track = flight.track[:, 1:4]
    row = int(np.argmin(distances_to_boxes(track, boxes_array(test_case.scenario.obstacles)).min(axis=1)))
    passing = passing_of(test_case.scenario, track, row, track[row])
    centre = centre_of(shape_of(tuple(map(tuple, flight.track[:, :4].tolist()))))
    x, y = (CELL_M * math.floor(round(place, 3) / CELL_M) for place in centre)
    return f"{passing}, way {x:.0f} {y:.0f}"


def _danger(distance_m: float) -> float:
    """Return 0..1: half at the safe distance, towards 1 only where an obstacle is touched."""
    depth = max(0.0, 1.0 - distance_m / SAFE_M)
    return (1.0 - DEPTH_SHARE * (1.0 - depth)) / (1.0 + math.exp(min(30.0, (distance_m - SAFE_M) / SLOPE_M)))


def _unflown(seen: Look) -> ModelScore:
    return ModelScore(seen.score, f"looks safe (narrowest passage {seen.gap_m:.1f} m); not flown")
