"""Boxes in the plane: corners, overlap, gaps, the allowed area, and the competition's distance.

Frame of the testing competition: x north, y east, z up, rotation counter-clockwise in the (x, y) plane about the
centre of the box. `length_m` lies along x before rotation, `width_m` along y.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Refused
from saflite.contract.test_case import Obstacle

NO_OBSTACLE_M = 1000.0  # distance told when there is no box at all
CORE_SCALE = 0.8  # the box that can be hit is 0.8 x the box that is seen (competition's world model)
BOX_COLUMNS = 8
_TOUCH_M = 1e-9  # boxes that only touch do not overlap

Point = tuple[float, float]


class Area(NamedTuple):
    """A rectangle along the axes in which whole boxes must lie (borders included)."""

    x_min_m: float
    x_max_m: float
    y_min_m: float
    y_max_m: float


class SizeLimits(NamedTuple):
    """Least and greatest side and height of a box."""

    side_min_m: float
    side_max_m: float
    height_min_m: float
    height_max_m: float


COMPETITION_AREA = Area(-40.0, 30.0, 10.0, 40.0)
COMPETITION_SIZES = SizeLimits(2.0, 20.0, 10.0, 25.0)
COMPETITION_OBSTACLES_MAX = 4


def corner_points(obstacle: Obstacle, scale: float = 1.0) -> tuple[Point, Point, Point, Point]:
    """Return the four corners (x_m, y_m), counter-clockwise; `scale` shrinks length and width about the centre."""
    turn = math.radians(obstacle.rotation_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    half_l, half_w = 0.5 * scale * obstacle.length_m, 0.5 * scale * obstacle.width_m

    def corner(along: float, across: float) -> Point:
        return obstacle.x_m + along * cos - across * sin, obstacle.y_m + along * sin + across * cos

    return corner(half_l, half_w), corner(-half_l, half_w), corner(-half_l, -half_w), corner(half_l, -half_w)


def corners(obstacle: Obstacle, scale: float = 1.0) -> NDArray[np.float64]:
    """Return the corners as an array of shape (4, 2), counter-clockwise, metres."""
    return np.array(corner_points(obstacle, scale), dtype=np.float64)


def _separation(first: Sequence[Point], second: Sequence[Point]) -> float:
    """Return the greatest signed gap along the edge normals of two rectangles; negative if they overlap."""
    greatest = -math.inf
    for mine, others in ((first, second), (second, first)):
        for index in (0, 1):
            (x0, y0), (x1, y1) = mine[index], mine[index + 1]
            length = math.hypot(x1 - x0, y1 - y0)
            if length == 0.0:  # a box without width is a line: its other edge parts it from others
                continue
            normal_x, normal_y = (y1 - y0) / length, (x0 - x1) / length
            own = [normal_x * x + normal_y * y for x, y in mine]
            other = [normal_x * x + normal_y * y for x, y in others]
            greatest = max(greatest, min(other) - max(own), min(own) - max(other))
    return greatest


def overlap(first: Obstacle, second: Obstacle) -> bool:
    """Return whether the two rotated boxes share area in the plane; touching is no overlap."""
    reach = math.hypot(first.length_m, first.width_m) + math.hypot(second.length_m, second.width_m)
    if 2 * math.hypot(first.x_m - second.x_m, first.y_m - second.y_m) > reach:
        return False
    return _separation(corner_points(first), corner_points(second)) < -_TOUCH_M


def point_distance(obstacle: Obstacle, x_m: float, y_m: float) -> float:
    """Return the distance in the plane from a point to the box, 0 inside, metres."""
    turn = math.radians(obstacle.rotation_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    dx, dy = x_m - obstacle.x_m, y_m - obstacle.y_m
    along, across = abs(dx * cos + dy * sin), abs(dy * cos - dx * sin)
    return math.hypot(max(0.0, along - 0.5 * obstacle.length_m), max(0.0, across - 0.5 * obstacle.width_m))


def gap(first: Obstacle, second: Obstacle) -> float:
    """Return the least distance in the plane between two boxes, 0 if they overlap or touch, metres.

    Two convex shapes apart from one another are closest at a corner of one of them.
    """
    if overlap(first, second):
        return 0.0
    here = (point_distance(second, x, y) for x, y in corner_points(first))
    there = (point_distance(first, x, y) for x, y in corner_points(second))
    return min(*here, *there)


def inside(obstacle: Obstacle, area: Area) -> bool:
    """Return whether the whole rotated box lies in `area` (a nanometre of rounding is forgiven)."""
    return all(
        area.x_min_m - _TOUCH_M <= x <= area.x_max_m + _TOUCH_M
        and area.y_min_m - _TOUCH_M <= y <= area.y_max_m + _TOUCH_M
        for x, y in corner_points(obstacle)
    )


def check_layout(
    obstacles: Sequence[Obstacle],
    area: Area = COMPETITION_AREA,
    max_count: int = COMPETITION_OBSTACLES_MAX,
    sizes: SizeLimits | None = None,
    where: str = "",
) -> None:
    """Raise Refused if boxes are too many, senseless, beyond `sizes`, outside `area`, or overlap.

    Rules of the UAV testing competition (2024/2025): whole rotated boxes in the area, no overlap, at most four.
    """
    if len(obstacles) > max_count:
        raise Refused("obstacles", where=where, expected=f"at most {max_count} boxes", got=len(obstacles))
    for number, obstacle in enumerate(obstacles, start=1):
        _check_box(f"obstacle {number}", obstacle, sizes, where)
        if not inside(obstacle, area):
            bounds = f"{area.x_min_m:g} < x < {area.x_max_m:g}, {area.y_min_m:g} < y < {area.y_max_m:g}"
            raise Refused(
                f"obstacle {number}",
                where=where,
                expected=f"the whole rotated box in {bounds}",
                got="corners " + " ".join(f"({x:.2f}, {y:.2f})" for x, y in corner_points(obstacle)),
            )
    for (i, first), (j, second) in combinations(enumerate(obstacles, start=1), 2):
        if overlap(first, second):
            raise Refused("obstacles", where=where, expected="boxes that do not overlap", got=f"{i} overlaps {j}")


def _check_box(name: str, obstacle: Obstacle, sizes: SizeLimits | None, where: str) -> None:
    numbers = (obstacle.x_m, obstacle.y_m, obstacle.z_m, obstacle.rotation_deg)
    sides = (obstacle.length_m, obstacle.width_m, obstacle.height_m)
    if not all(math.isfinite(number) for number in (*numbers, *sides)):
        raise Refused(name, where=where, expected="finite numbers", got=(*sides, *numbers))
    if min(sides) <= 0:
        raise Refused(name, where=where, expected="length, width and height above 0", got=sides)
    if sizes is None:
        return
    for word, side, least, most in (
        ("length_m", obstacle.length_m, sizes.side_min_m, sizes.side_max_m),
        ("width_m", obstacle.width_m, sizes.side_min_m, sizes.side_max_m),
        ("height_m", obstacle.height_m, sizes.height_min_m, sizes.height_max_m),
    ):
        if not least <= side <= most:
            raise Refused(f"{name} {word}", where=where, expected=f"{least:g} to {most:g}", got=side)


def boxes_array(obstacles: Sequence[Obstacle]) -> NDArray[np.float64]:
    """Return the boxes as compiled code reads them: shape (k, 8), C order.

    Columns: x_m, y_m, half_length_m, half_width_m, cos(rotation), sin(rotation), z_base_m, z_top_m.
    """
    rows = np.empty((len(obstacles), BOX_COLUMNS), dtype=np.float64)
    for row, box in zip(rows, obstacles, strict=True):
        turn = math.radians(box.rotation_deg)
        row[:] = (
            *(box.x_m, box.y_m, 0.5 * box.length_m, 0.5 * box.width_m),
            *(math.cos(turn), math.sin(turn), box.z_m, box.z_m + box.height_m),
        )
    return rows


def distances_to_boxes(points: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the competition's distance of points (n, 3) to each box (k, 8) as (n, k), metres.

    In the plane to the full box; over the footprint above the top it is the height above the top; 0 inside.
    """
    dx = points[:, 0, None] - boxes[None, :, 0]
    dy = points[:, 1, None] - boxes[None, :, 1]
    along = np.abs(dx * boxes[:, 4] + dy * boxes[:, 5]) - boxes[:, 2]
    across = np.abs(dy * boxes[:, 4] - dx * boxes[:, 5]) - boxes[:, 3]
    planar = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    above = np.maximum(points[:, 2, None] - boxes[None, :, 7], 0.0)
    over = (along <= 0.0) & (across <= 0.0)
    return np.where(over, above, planar).astype(np.float64)


def distance_to_boxes(points: NDArray[np.float64], boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the competition's distance of points (n, 3) to the nearest of the boxes (k, 8) as (n,), metres."""
    if len(boxes) == 0:
        return np.full(len(points), NO_OBSTACLE_M)
    nearest: NDArray[np.float64] = distances_to_boxes(points, boxes).min(axis=1)
    return nearest
