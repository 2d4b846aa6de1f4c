"""Drawing whole layouts: anywhere in the area, or as a gate astride the mission's path. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Mission, Obstacle
from saflite.flight.geometry import (
    COMPETITION_AREA,
    COMPETITION_OBSTACLES_MAX,
    COMPETITION_SIZES,
    Area,
    SizeLimits,
    gap,
)
from saflite.flight.mission import places_of
from saflite.mutator.operators import boxes
from saflite.mutator.operators.boxes import Rng, Rules
from saflite.mutator.strategy import Chosen, Option, Options

TRIES_PER_BOX = 200
TRIES_PER_LAYOUT = 50

_AREA, _SIZES = COMPETITION_AREA, COMPETITION_SIZES
RULE_OPTIONS: Options = {
    "x_min_m": Option(_AREA.x_min_m, "southern border of the allowed area", -1000, 1000),
    "x_max_m": Option(_AREA.x_max_m, "northern border of the allowed area", -1000, 1000),
    "y_min_m": Option(_AREA.y_min_m, "western border of the allowed area", -1000, 1000),
    "y_max_m": Option(_AREA.y_max_m, "eastern border of the allowed area", -1000, 1000),
    "side_min_m": Option(_SIZES.side_min_m, "least length and width of a box", 0.1, 100),
    "side_max_m": Option(_SIZES.side_max_m, "greatest length and width of a box", 0.1, 100),
    "height_min_m": Option(15.0, "least height of a box (the competition wants more than 10)", 0.1, 100),
    "height_max_m": Option(_SIZES.height_max_m, "greatest height of a box", 0.1, 100),
    "clearance_m": Option(3.0, "room kept free around take-off, way-points and landing", 0, 50),
    "gap_m": Option(0.0, "least gap between two boxes (0: they may touch)", 0, 50),
}
"""The rules of the competition as settings; strategies that place boxes share them."""

COUNT_MAX = COMPETITION_OBSTACLES_MAX


class Sizes(NamedTuple):
    """From which sides and heights boxes are drawn, metres."""

    side_m: tuple[float, float]
    height_m: tuple[float, float]


def rules_of(chosen: Chosen, mission: Mission) -> Rules:
    """Return the rules the settings name; raises Refused where a least value is above the greatest."""
    for least, most in (("x_min_m", "x_max_m"), ("y_min_m", "y_max_m"), ("side_min_m", "side_max_m")):
        in_order(chosen, least, most)
    in_order(chosen, "height_min_m", "height_max_m")
    area = Area(*(chosen.real(name) for name in ("x_min_m", "x_max_m", "y_min_m", "y_max_m")))
    sizes = SizeLimits(*(chosen.real(f"{word}_m") for word in ("side_min", "side_max", "height_min", "height_max")))
    keep = boxes.places_to_keep_clear(mission)
    return Rules(area, sizes, keep, chosen.real("clearance_m"), chosen.real("gap_m"))


def in_order(chosen: Chosen, least: str, most: str) -> None:
    """Raise Refused if the setting `least` is above the setting `most`."""
    if chosen.real(least) > chosen.real(most):
        got = f"{chosen.real(least):g} and {chosen.real(most):g}"
        raise Refused(f"strategy settings {least}, {most}", expected=f"{least} at most {most}", got=got)


def anywhere(rng: Rng, count: int, sizes: Sizes, place: Area, rules: Rules) -> tuple[Obstacle, ...]:
    """Return a layout of `count` boxes with centres in `place`; raises Refused if the rules leave no room."""
    for _ in range(TRIES_PER_LAYOUT):
        layout: tuple[Obstacle, ...] = ()
        for _ in range(TRIES_PER_BOX):
            box = boxes.draw_box(rng, sizes.side_m, sizes.height_m, place)
            if boxes.allowed(box, layout, rules):
                layout = (*layout, box)
            if len(layout) == count:
                return layout
    raise Refused("strategy settings", expected=f"rules that leave room for {count} boxes", got="no room found")


class Gate(NamedTuple):
    """How a gate is drawn: how far its first box may stand off the path, how far apart centres and boxes are."""

    off_path_m: float = 5.0
    apart_m: tuple[float, float] = (8.0, 16.0)
    slant_deg: float = 45.0
    passage_m: tuple[float, float] = (0.0, math.inf)
    tries: int = TRIES_PER_LAYOUT


WALL = Gate(off_path_m=3.0, apart_m=(8.0, 24.0), passage_m=(5.0, 8.0), tries=400)
"""A box across the path and one beside it, with a passage that looks wide enough and that the vehicle does not take."""

WALL_SIDE_M, WALL_NEAR_M = 6.0, 8.0
"""Least side of these two, and how near one of them any further box stands."""


def astride(rng: Rng, mission: Mission, sizes: Sizes, rules: Rules, gate: Gate) -> tuple[Obstacle, ...] | None:
    """Return two boxes astride a leg of the mission, None if none of the tries kept the rules.

    The idea of the 2025 competition's placement heuristics: the first box close to the path, the second 8 to 16 m
    from it, so that the vehicle is tempted to fly between them.
    """
    legs = boxes.legs_in_area(places_of(mission), rules.area)
    if not legs:
        return None
    for _ in range(gate.tries):
        pair = _gate(rng, legs[int(rng.integers(len(legs)))], sizes, rules.area, gate)
        if not gate.passage_m[0] <= gap(*pair) <= gate.passage_m[1]:
            continue
        if boxes.allowed(pair[0], (), rules) and boxes.allowed(pair[1], pair[:1], rules):
            return pair
    return None


def wall(rng: Rng, count: int, mission: Mission, sizes: Sizes, rules: Rules) -> tuple[Obstacle, ...] | None:
    """Return a wall of two boxes and `count` - 2 near them, None if none of the tries kept the rules."""
    limits = rules.sizes
    side_m = min(max(WALL_SIDE_M, limits.side_min_m), limits.side_max_m), limits.side_max_m
    layout: tuple[Obstacle, ...] | None = astride(rng, mission, sizes._replace(side_m=side_m), rules, WALL)
    tries = TRIES_PER_BOX
    while layout is not None and len(layout) < count and tries:
        box, tries = boxes.draw_box(rng, sizes.side_m, sizes.height_m, rules.area), tries - 1
        if boxes.allowed(box, layout, rules) and min(gap(box, other) for other in layout) <= WALL_NEAR_M:
            layout = (*layout, box)
    return layout


def _gate(
    rng: Rng, leg: tuple[float, float, float, float], sizes: Sizes, area: Area, gate: Gate
) -> tuple[Obstacle, Obstacle]:
    x0, y0, x1, y1 = leg
    along = rng.uniform(0.0, 1.0)
    course = math.atan2(y1 - y0, x1 - x0)
    side = 1.0 if rng.random() < 0.5 else -1.0
    across = course + side * math.pi / 2
    off_m = rng.uniform(-gate.off_path_m, gate.off_path_m)
    first_x = x0 + along * (x1 - x0) + off_m * math.cos(across)
    first_y = y0 + along * (y1 - y0) + off_m * math.sin(across)
    slant = math.radians(rng.uniform(-gate.slant_deg, gate.slant_deg))
    apart_m = rng.uniform(*gate.apart_m)
    second_x, second_y = first_x - apart_m * math.cos(across + slant), first_y - apart_m * math.sin(across + slant)
    return (
        _at(boxes.draw_box(rng, sizes.side_m, sizes.height_m, area), first_x, first_y),
        _at(boxes.draw_box(rng, sizes.side_m, sizes.height_m, area), second_x, second_y),
    )


def _at(box: Obstacle, x_m: float, y_m: float) -> Obstacle:
    return boxes.tidy(msgspec.structs.replace(box, x_m=float(x_m), y_m=float(y_m)))


def count_between(rng: np.random.Generator, least: int, most: int) -> int:
    """Return a whole number drawn evenly from least to most, both included."""
    return int(rng.integers(least, most + 1))


def mission_of(mission: Mission | None, target: TargetInfo) -> Mission:
    """Return the mission of a template; raises Refused where there is none, or the target minds no obstacles."""
    if not target.obstacles:
        raise Refused("strategy", expected="a target that minds obstacles", got=target.name)
    if mission is None:
        raise Refused("strategy", expected="a campaign with a mission", got="none", fix="set `mission` in the campaign")
    return mission
