"""Drawing and changing boxes under the competition's rules. Pure: the random source is handed in."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from saflite.contract.test_case import Mission, Obstacle
from saflite.flight.geometry import Area, SizeLimits, gap, inside, overlap, point_distance
from saflite.flight.mission import Waypoint, places_of

Rng = np.random.Generator
Attribute = Literal["rotation_deg", "x_m", "y_m", "length_m", "width_m"]
ATTRIBUTES: tuple[Attribute, ...] = ("rotation_deg", "x_m", "y_m", "length_m", "width_m")


class Rules(NamedTuple):
    """What a layout must keep: area and sizes of the whole rotated boxes, and places the mission needs free.

    `keep_clear` are way-points, take-off and landing (x_m, y_m); no box comes nearer than `clearance_m`, otherwise
    the mission could not be flown safely at all. Two boxes keep at least `gap_m` (0: they may touch).
    """

    area: Area
    sizes: SizeLimits
    keep_clear: tuple[tuple[float, float], ...] = ()
    clearance_m: float = 3.0
    gap_m: float = 0.0


def places_to_keep_clear(mission: Mission) -> tuple[tuple[float, float], ...]:
    """Return where the mission takes off, turns and lands, (x_m, y_m)."""
    return tuple((place.x_m, place.y_m) for place in places_of(mission))


def allowed(box: Obstacle, others: Iterable[Obstacle], rules: Rules) -> bool:
    """Return whether the box may stand among the others."""
    sizes = rules.sizes
    return (
        sizes.side_min_m <= min(box.length_m, box.width_m)
        and max(box.length_m, box.width_m) <= sizes.side_max_m
        and sizes.height_min_m <= box.height_m <= sizes.height_max_m
        and inside(box, rules.area)
        and all(point_distance(box, x, y) >= rules.clearance_m for x, y in rules.keep_clear)
        and not any(overlap(box, other) or gap(box, other) < rules.gap_m for other in others)
    )


def tidy(box: Obstacle) -> Obstacle:
    """Return the same box with its rotation in 0..90 degrees (sides swapped if need be) and two decimals.

    A rectangle turned by 90 degrees is the rectangle with its sides swapped: this is the form of the competition.
    """
    turn = box.rotation_deg % 180.0
    length_m, width_m = box.length_m, box.width_m
    if turn > 90.0:
        turn, length_m, width_m = turn - 90.0, width_m, length_m
    return Obstacle(
        length_m=round(length_m, 2),
        width_m=round(width_m, 2),
        height_m=round(box.height_m, 2),
        x_m=round(box.x_m, 2),
        y_m=round(box.y_m, 2),
        z_m=box.z_m,
        rotation_deg=round(turn, 1),
    )


def draw_box(rng: Rng, side_m: tuple[float, float], height_m: tuple[float, float], place: Area) -> Obstacle:
    """Return a box with its centre in `place`, sides and height uniform, turned by 0..90 degrees."""
    length_m, width_m = rng.uniform(*side_m, size=2)
    return tidy(
        Obstacle(
            length_m=float(length_m),
            width_m=float(width_m),
            height_m=float(rng.uniform(*height_m)),
            x_m=float(rng.uniform(place.x_min_m, place.x_max_m)),
            y_m=float(rng.uniform(place.y_min_m, place.y_max_m)),
            rotation_deg=float(rng.uniform(0.0, 90.0)),
        )
    )


def nudge(box: Obstacle, attribute: Attribute, step: float) -> Obstacle:
    """Return the box with one attribute changed by `step`; the box given stays as it is."""
    return tidy(msgspec.structs.replace(box, **{attribute: getattr(box, attribute) + step}))


def replace_at(layout: Sequence[Obstacle], index: int, box: Obstacle) -> tuple[Obstacle, ...]:
    """Return the layout with one box replaced."""
    return (*layout[:index], box, *layout[index + 1 :])


def legs_in_area(places: Sequence[Waypoint], area: Area) -> tuple[tuple[float, float, float, float], ...]:
    """Return the pieces (x0, y0, x1, y1) of the mission's legs that cross the area (Liang-Barsky clipping)."""
    pieces = (_clip((a.x_m, a.y_m), (b.x_m, b.y_m), area) for a, b in pairwise(places))
    return tuple(piece for piece in pieces if piece is not None)


def _clip(start: tuple[float, float], end: tuple[float, float], area: Area) -> tuple[float, float, float, float] | None:
    dx, dy = end[0] - start[0], end[1] - start[1]
    enter, leave = 0.0, 1.0
    for step, room in (
        (-dx, start[0] - area.x_min_m),
        (dx, area.x_max_m - start[0]),
        (-dy, start[1] - area.y_min_m),
        (dy, area.y_max_m - start[1]),
    ):
        if step == 0.0:
            if room < 0.0:
                return None
        elif step < 0.0:
            enter = max(enter, room / step)
        else:
            leave = min(leave, room / step)
    if enter >= leave or math.hypot(dx, dy) * (leave - enter) < 1.0:
        return None
    return start[0] + enter * dx, start[1] + enter * dy, start[0] + leave * dx, start[1] + leave * dy
