"""How a vehicle passed an obstacle: on which leg of its mission, as which obstacle on its way, on which side."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Obstacle, Scenario
from saflite.flight.geometry import boxes_array, distances_to_boxes
from saflite.flight.mission import places_of

REACHED_M = 3.0
"""A way-point counts as reached from the first moment it is so near in the plane."""

SIDES = {1.0: "left of", -1.0: "right of", 0.0: "over"}
Points = NDArray[np.float64]


class Passing(NamedTuple):
    """`leg` from 1; `order`: the obstacle's place among those passed, from 1; `side`: 1 left, -1 right, 0 over it."""

    leg: int
    order: int
    side: float

    def __str__(self) -> str:
        return f"{SIDES[self.side]} obstacle {self.order} on leg {self.leg}"


def passing_of(scenario: Scenario, track: Points, row: int, closest: Points) -> Passing:
    """Return how the obstacle nearest to the point `closest`, shape (3,), was passed.

    `track`, shape (points, 3) m, is the whole flight; `closest` was flown after its point `row`.
    """
    each = distances_to_boxes(track, boxes_array(scenario.obstacles))
    near = int(np.argmin(distances_to_boxes(closest[None, :], boxes_array(scenario.obstacles))[0]))
    when = np.argmin(each, axis=0)
    leg, course = _leg(scenario, np.append(track[: row + 1], closest[None, :], axis=0))
    order = 1 + int(np.count_nonzero(when < when[near]))
    return Passing(leg, order, _side(scenario.obstacles[near], closest, course))


def _leg(scenario: Scenario, track: Points) -> tuple[int, tuple[float, float]]:
    """Return the leg flown at the end of a track, from 1, and its direction; without a mission the track's own."""
    start, leg, row = (0.0, 0.0), 1, 0
    places = places_of(scenario.mission) if scenario.mission is not None else ()
    for place in places:
        goal = place.x_m, place.y_m
        if math.dist(start, goal) <= REACHED_M:
            continue  # take-off
        near = np.flatnonzero(np.hypot(track[row:, 0] - goal[0], track[row:, 1] - goal[1]) < REACHED_M)
        if not len(near) or goal == (places[-1].x_m, places[-1].y_m):
            return leg, (goal[0] - start[0], goal[1] - start[1])
        start, leg, row = goal, leg + 1, row + int(near[0])
    return leg, (float(track[-1, 0] - track[0, 0]), float(track[-1, 1] - track[0, 1]))


def _side(box: Obstacle, point: Points, course: tuple[float, float]) -> float:
    """Return 1 where the vehicle passes left of the box seen along the course (x north, y east), -1 right, 0 over."""
    if point[2] > box.z_m + box.height_m:
        return 0.0
    across = course[0] * (point[1] - box.y_m) - course[1] * (point[0] - box.x_m)
    return -1.0 if across > 0 else 1.0
