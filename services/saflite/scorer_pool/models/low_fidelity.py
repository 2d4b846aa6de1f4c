"""Flies the mission on a kinematic vehicle with the real planner, where a first look says that it is worth it.

The look is geometry, more than 1,000 test cases a second; what looks safe beyond doubt is not flown.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict

import numpy as np

from saflite.contract.rng import derive_seed
from saflite.contract.score import SCORE_MAX
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase, draw_key, identity
from saflite.flight.geometry import boxes_array
from saflite.flight.mission import waypoints
from saflite.flight.planner.kinematic import KinematicFlight, fly_kinematic
from saflite.scorer_pool.geometry_score import Look, look
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.features import has_layout
from saflite.scorer_pool.model import MIDDLE, Job, ModelScore, ScoreSheet, Tools

WORTH_FLYING = 2.0
"""Geometry score from which a kinematic flight is spent on a test case."""

DOUBTFUL_M = 1.8
"""Below it two more flights with other noise follow: what looks most dangerous is worth a second look."""

FLIGHTS_MAX = 3
SAFE_M, SLOPE_M = 1.5, 0.6
KEPT_MAX = 10_000
_ONE_AT_A_TIME = threading.Lock()
"""The compiled planner works in one block of memory per process."""


class Model:
    """Scores by the least distance of cheap flights; by geometry, below 2, where none was spent."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("low_fidelity", argument)
        self.label = "low_fidelity"
        self._kept: OrderedDict[str, ModelScore] = OrderedDict()
        self._lock = threading.Lock()

    def score(self, job: Job) -> ScoreSheet:
        """Return one score per test case; stops early, with the middle for the rest, once cancelled."""
        return ScoreSheet(tuple(self._mark(case, job) for case in job.test_cases), digest="low_fidelity-3")

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
    flights = [_fly(test_case, 0)]
    if flights[0].min_distance_m < DOUBTFUL_M:
        flights += [_fly(test_case, number) for number in range(1, FLIGHTS_MAX)]
    value = sum(_danger(flight.min_distance_m) for flight in flights) / len(flights)
    came = ", ".join(f"{flight.min_distance_m:.2f}" for flight in flights)
    return ModelScore(SCORE_MAX * value, f"came within {came} m in {flights[0].duration_s:.0f} s")


def _fly(test_case: TestCase, number: int) -> KinematicFlight:
    """Fly once; the noise depends on the test case and the number only, so a score is the same in every batch."""
    mission = test_case.scenario.mission
    assert mission is not None
    points = np.array([(place.x_m, place.y_m, place.z_m) for place in waypoints(mission)], dtype=np.float64)
    seed = derive_seed(test_case.rng_seed, "low_fidelity", draw_key(test_case), number)
    with _ONE_AT_A_TIME:
        return fly_kinematic(points, boxes_array(test_case.scenario.obstacles), rng_seed=seed)


def _danger(distance_m: float) -> float:
    """Return 0..1: half at the safe distance."""
    return 1.0 / (1.0 + math.exp(min(30.0, (distance_m - SAFE_M) / SLOPE_M)))


def _unflown(seen: Look) -> ModelScore:
    return ModelScore(seen.score, f"looks safe (narrowest passage {seen.gap_m:.1f} m); not flown")
