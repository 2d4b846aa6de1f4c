"""Ways in the plane, flown or planned, as strategies look at them: points, nearness, crossings. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

from saflite.contract.test_case import Mission, Obstacle
from saflite.contract.work import Outcome
from saflite.flight.geometry import Area, point_distance
from saflite.flight.mission import places_of

Point = tuple[float, float]
Track = tuple[Point, ...]
POINTS_MAX = 100_000  # of a planned way: one round the world has wider steps
STEP_M = 1.4  # what a vehicle cruises in the second between two points of a told track


def flown(outcome: Outcome) -> Track:
    """Return where a flight was, (x_m, y_m) about once a second; empty where nothing was told of it."""
    return tuple((x_m, y_m) for _, x_m, y_m, _ in outcome.track)


def planned(mission: Mission) -> Track:
    """Return the straight way from take-off through the way-points, about as dense as a flight is told."""
    corners = [(0.0, 0.0), *((place.x_m, place.y_m) for place in places_of(mission))]
    points = [corners[0]]
    whole_m = sum(math.dist(start, end) for start, end in pairwise(corners))
    step_m = max(STEP_M, whole_m / POINTS_MAX)
    for (x0, y0), (x1, y1) in pairwise(corners):
        steps = max(1, math.ceil(math.hypot(x1 - x0, y1 - y0) / step_m))
        points += [(x0 + (x1 - x0) * n / steps, y0 + (y1 - y0) * n / steps) for n in range(1, steps + 1)]
    return tuple(points)


def within(point: Point, area: Area) -> bool:
    """Return whether a point lies in the area, borders left out."""
    return area.x_min_m < point[0] < area.x_max_m and area.y_min_m < point[1] < area.y_max_m


def distance(box: Obstacle, points: Iterable[Point]) -> float:
    """Return the least distance in the plane from any of the points to a box, infinite without points, metres."""
    return min((point_distance(box, x, y) for x, y in points), default=math.inf)


def crosses(track: Track, start: Point, end: Point) -> bool:
    """Return whether the track crosses the straight line from start to end; touching its ends counts."""
    return any(_cross(a, b, start, end) for a, b in pairwise(track))


def _cross(a: Point, b: Point, c: Point, d: Point) -> bool:
    return _side(a, b, c) * _side(a, b, d) <= 0 and _side(c, d, a) * _side(c, d, b) <= 0 and a != b


def _side(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
