"""Boxes drawn inside a free circle, as TUMB places them: about a point of the way, clear of what stands. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

from saflite.contract.test_case import Obstacle
from saflite.flight.geometry import Area
from saflite.mutator.operators.boxes import Rng
from saflite.mutator.operators.tracks import Point

COVER = 4  # a box is covered by so many circles along each side
SHARE = (0.5, 0.9)  # of the free circle that a second or later box may take
HALF_LENGTH = (0.1, 0.9)  # of the circle's radius
SLACK = 0.999
HEIGHT_M = 25.0


def border_distance(point: Point, area: Area) -> float:
    """Return the distance to the nearest border of the area, negative outside, metres."""
    x, y = point
    return min(x - area.x_min_m, area.x_max_m - x, y - area.y_min_m, area.y_max_m - y)


def cover(box: Obstacle) -> list[tuple[float, float, float]]:
    """Return 4 x 4 circles (x_m, y_m, radius_m) that cover the box: one round each of its equal parts."""
    turn = math.radians(box.rotation_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    radius_m = 0.5 * math.hypot(box.length_m, box.width_m) / COVER
    shares = [(2 * n + 1 - COVER) / (2 * COVER) for n in range(COVER)]
    return [
        (
            box.x_m + box.length_m * a * cos - box.width_m * b * sin,
            box.y_m + box.length_m * a * sin + box.width_m * b * cos,
            radius_m,
        )
        for a in shares
        for b in shares
    ]


def free_radius(point: Point, layout: Sequence[Obstacle], area: Area) -> float:
    """Return the radius of the largest circle about the point that meets neither border nor box; 0 or less: none."""
    circles = [circle for box in layout for circle in cover(box)]
    return min(
        border_distance(point, area),
        *(math.hypot(point[0] - x, point[1] - y) - radius_m for x, y, radius_m in circles),
        math.inf,
    )


def draw_radius(rng: Rng, point: Point, layout: Sequence[Obstacle], area: Area) -> float:
    """Return the radius a new box may fill: all of the free circle for the first box, a drawn share for others."""
    radius_m = free_radius(point, layout, area)
    return radius_m * float(rng.uniform(*SHARE)) if layout else radius_m


def draw_inside(rng: Rng, point: Point, radius_m: float) -> Obstacle:
    """Return a box whose corners lie on the circle (a little inside), turned by 0..90 degrees, 25 m high."""
    half_length_m = float(rng.uniform(*HALF_LENGTH)) * radius_m
    half_width_m = math.sqrt(radius_m**2 - half_length_m**2)
    return Obstacle(
        length_m=2 * half_length_m * SLACK,
        width_m=2 * half_width_m * SLACK,
        height_m=HEIGHT_M,
        x_m=point[0],
        y_m=point[1],
        rotation_deg=float(rng.uniform(0.0, 90.0)),
    )
