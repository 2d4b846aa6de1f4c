"""Pairs of boxes astride a point of the vehicle's way, as CAMBA draws and moves them. Pure.

The left box stands at lesser x than the way, the right one at greater. Rotations go from 0 to 180 degrees here: which
half a box is drawn from depends on its side and on whether the vehicle flies up, towards greater y (`leans`).
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Obstacle
from saflite.flight.geometry import Area, corner_points, gap, inside, overlap
from saflite.mutator.operators import boxes
from saflite.mutator.operators.boxes import Rng, Rules
from saflite.mutator.operators.tracks import Point, Track, crosses, distance

LENGTH_M, WIDTH_M, HEIGHT_M = (7.0, 12.0), (5.0, 8.0), (15.0, 25.0)
LEFT_M, RIGHT_M, ALONG_M = (-15.0, -5.0), (0.0, 3.0), (-5.0, 5.0)  # of the centres, from the point of the way
GAP_M = (5.6, 7.8)  # between the two boxes
AVOIDED_M = (2.8, 3.9)  # no box at such a distance from the way: it would be passed at leisure
BOX_TRIES, BATCH, PAIR_TRIES = 1000, 50, 50
INWARDS_M, OUTWARDS_M, TURN_DEG, GROWTH_M = 0.3, 1.0, 10.0, 1.5
LONG_M = 10.5  # a box this long is turned, not lengthened
ROWS = 5  # points of the way to either side that count as near

Pair = tuple[Obstacle, Obstacle]
Where = Literal["between", "left", "right", "nowhere"]


class Anchor(NamedTuple):
    """A point of the vehicle's way and whether y rises along it there."""

    x_m: float
    y_m: float
    up: bool


def anchors(track: Track, place: Area) -> list[int]:
    """Return which points of the way lie in the place pairs are built around."""
    return [
        index
        for index, (x, y) in enumerate(track)
        if place.x_min_m < x < place.x_max_m and place.y_min_m < y < place.y_max_m
    ]


def local(track: Track, index: int) -> Track:
    """Return the points of the way near one of them, that one included."""
    return track[max(0, index - ROWS) : index + ROWS + 1]


def rises(track: Track) -> bool:
    """Return whether y rises from every point to the next."""
    return all(a[1] < b[1] for a, b in pairwise(track))


def leans(side: int, up: bool) -> int:
    """Return -1 for a box drawn from 0 to 90 degrees, 1 for one drawn from 90 to 180; side 0 is left, 1 right."""
    return -1 if (side == 0) == up else 1


def draw(rng: Rng, anchor: Anchor, near: Track, area: Area, rules: Rules | None) -> Pair | None:
    """Return a random pair about the anchor, None if none of the tries fits.

    Published rules: whole boxes in the area, 5.6 to 7.8 m between them, neither at 2.8 to 3.9 m from the way near the
    anchor. With `rules` both keep those as well, as the boxes `tidied` makes of them.
    """
    for _ in range(PAIR_TRIES):
        left = _box(rng, anchor, 0, near, area, rules, ())
        right = None if left is None else _box(rng, anchor, 1, near, area, rules, (left,))
        if left is not None and right is not None:
            return left, right
    return None


def _box(
    rng: Rng, anchor: Anchor, side: int, near: Track, area: Area, rules: Rules | None, others: tuple[Obstacle, ...]
) -> Obstacle | None:
    first_deg = 0.0 if leans(side, anchor.up) < 0 else 90.0
    x_m, y_m = anchor.x_m, anchor.y_m
    least, most = np.array(
        [LENGTH_M, WIDTH_M, HEIGHT_M, RIGHT_M if side else LEFT_M, ALONG_M, (first_deg, first_deg + 90.0)]
    ).T
    offset = np.array([0.0, 0.0, 0.0, x_m, y_m, 0.0])
    for _ in range(BOX_TRIES // BATCH):
        drawn = rng.uniform(least, most, size=(BATCH, 6)) + offset
        for row in drawn[_may_be_accepted(drawn, others, area)].tolist():
            length_m, width_m, height_m, x_m, y_m, rotation_deg = row
            box = Obstacle(
                length_m=length_m, width_m=width_m, height_m=height_m, x_m=x_m, y_m=y_m, rotation_deg=rotation_deg
            )
            if accepted(box, others, near, area) and (rules is None or fits((box, *others), rules)):
                return box
    return None


def _may_be_accepted(drawn: NDArray[np.float64], others: tuple[Obstacle, ...], area: Area) -> NDArray[np.bool_]:
    """Return which boxes (n, 6) lie in the area and may stand at a gap that is allowed, by circles: most do not."""
    length_m, width_m, _, x_m, y_m, rotation_deg = drawn.T
    turn = np.radians(rotation_deg)
    along_m = 0.5 * (length_m * np.abs(np.cos(turn)) + width_m * np.abs(np.sin(turn)))
    across_m = 0.5 * (length_m * np.abs(np.sin(turn)) + width_m * np.abs(np.cos(turn)))
    may: NDArray[np.bool_] = (x_m - along_m >= area.x_min_m) & (x_m + along_m <= area.x_max_m)
    may &= (y_m - across_m >= area.y_min_m) & (y_m + across_m <= area.y_max_m)
    for other in others:
        apart_m = np.hypot(x_m - other.x_m, y_m - other.y_m)
        within_m = 0.5 * (np.minimum(length_m, width_m) + min(other.length_m, other.width_m))
        about_m = 0.5 * (np.hypot(length_m, width_m) + math.hypot(other.length_m, other.width_m))
        may &= (apart_m - within_m >= GAP_M[0]) & (apart_m - about_m <= GAP_M[1])
    return may


def accepted(box: Obstacle, others: tuple[Obstacle, ...], near: Track, area: Area) -> bool:
    """Return whether a box may be placed by the published rules."""
    return (
        inside(box, area)
        and all(not overlap(box, other) and GAP_M[0] <= gap(box, other) <= GAP_M[1] for other in others)
        and not AVOIDED_M[0] < distance(box, near) < AVOIDED_M[1]
    )


def fits(layout: tuple[Obstacle, ...], rules: Rules) -> bool:
    """Return whether the boxes keep the rules of layouts once tidied."""
    tidied = [boxes.tidy(box) for box in layout]
    return all(boxes.allowed(box, tidied[:place], rules) for place, box in enumerate(tidied))


def untidied(layout: Pair, up: bool) -> Pair:
    """Return the same boxes with the rotations they were drawn with, from 0..90 degrees back to 0..180."""
    left, right = (_from_half(box, leans(side, up)) for side, box in enumerate(layout))
    return left, right


def _from_half(box: Obstacle, lean: int) -> Obstacle:
    if lean < 0 or box.rotation_deg >= 90.0:
        return box
    turned = {"length_m": box.width_m, "width_m": box.length_m, "rotation_deg": box.rotation_deg + 90.0}
    return msgspec.structs.replace(box, **turned)


def where(track: Track, pair: Pair, up: bool) -> Where:
    """Return where the flight passed the pair.

    Between, if it crossed the line from centre to centre; else by the side of the box that a piece of the track came
    nearest to, of the pieces at the boxes' y that go the way of the anchor; nowhere if there is none.
    """
    left, right = pair
    if crosses(track, (left.x_m, left.y_m), (right.x_m, right.y_m)):
        return "between"
    across = [y for box in pair for _, y in corner_points(box)]
    passing: list[Point] = [
        here for here, there in pairwise(track) if min(across) <= here[1] <= max(across) and (there[1] > here[1]) == up
    ]
    if not passing:
        return "nowhere"
    return "left" if distance(left, passing) <= distance(right, passing) else "right"


def moved(pair: Pair, passed: Where, up: bool, scale: float = 1.0) -> Pair:
    """Return the pair changed by where the flight passed it: closed where it flew between, opened where it did not.

    `scale` stretches every step; 1 is the published change. Nowhere leaves the pair as it is.
    """
    left, right = pair
    if passed == "between":
        return _shifted(left, INWARDS_M * scale), _shifted(right, -INWARDS_M * scale)
    if passed == "left":
        return _grown(_shifted(left, -OUTWARDS_M * scale), leans(0, up), scale), right
    if passed == "right":
        return left, _grown(_shifted(right, OUTWARDS_M * scale), leans(1, up), scale)
    return pair


def _shifted(box: Obstacle, dx_m: float) -> Obstacle:
    return msgspec.structs.replace(box, x_m=box.x_m + dx_m)


def _grown(box: Obstacle, lean: int, scale: float) -> Obstacle:
    """Return the box turned, lengthened, or both: a long one is turned, one that can turn no further lengthened."""
    long = box.length_m >= LONG_M
    turns = box.rotation_deg > TURN_DEG if lean < 0 else box.rotation_deg < 180.0 - TURN_DEG
    turn_deg = 0.0 if not long and not turns else lean * TURN_DEG * scale
    growth_m = 0.0 if long and turns else GROWTH_M * scale
    return msgspec.structs.replace(box, length_m=box.length_m + growth_m, rotation_deg=box.rotation_deg + turn_deg)
