"""MAP-Elites over pairs of boxes after DeepHyperion-UAV: keeps the closest flight of every kind of layout.

Two boxes; an archive whose cells are the distance between the centres and the angle of the line between them
(`cells` by `cells`); fitness is the flight's distance to the boxes, less is better. Parents are drawn evenly over the
elites or by rank of their contribution (children placed / times chosen, new elites 1). A child changes one of
rotation, x, y, length, width of one box by 10-20 degrees or 2-5 m.

Mended against the published tool: a child differs from its parent in exactly one attribute (there, draws were carried
over); area and overlap are checked on whole rotated boxes; cells are real cells (there 0.1 m x 0.1 degree); sides
have an upper limit; rotation is wrapped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np

from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Obstacle, Origin, TestCase, draw_key, identity
from saflite.contract.work import Outcome
from saflite.flight.geometry import Area
from saflite.mutator.operators import boxes, layouts
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

BOXES = 2
TURN_DEG, MOVE_M = (10.0, 20.0), (2.0, 5.0)
FIRST_SIDE_M, FIRST_PLACE = (5.0, 20.0), Area(-20.0, 20.0, 15.0, 30.0)  # the published tool's first population
TRIES = 200
DISTANCE_MAX_M = math.hypot(70.0, 30.0)  # diagonal of the competition's area

Cell = tuple[int, int]


class Elite(NamedTuple):
    """The closest flight of a cell."""

    test_case: TestCase
    identity: str
    fitness_m: float


class Strategy:
    """The archive and the counts of what each elite contributed."""

    proposes: ClassVar[Proposes] = "obstacles"
    options: ClassVar[Options] = {
        "population": Option(30, "random layouts flown before the first mutation", 1, 10_000),
        "cells": Option(25, "cells of the archive along each feature", 1, 1000),
        "rank_share": Option(0.5, "share of parents drawn by rank instead of evenly", 0, 1),
        "rank_bias": Option(1.5, "how much rank counts, above 1 to 2", 1.01, 2),
        "gates": Option(0.5, "share of the first layouts that stand astride the path (the published tool: 0)", 0, 1),
        **layouts.RULE_OPTIONS,
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings; raises Refused for a bad one, no mission, or a target that minds no boxes."""
        self._chosen = Chosen(settings, self.options)
        self._template = template
        self._mission = layouts.mission_of(template.scenario.mission, target)
        self._rules = layouts.rules_of(self._chosen, self._mission)
        limits = self._rules.sizes
        side_m = (max(FIRST_SIDE_M[0], limits.side_min_m), min(FIRST_SIDE_M[1], limits.side_max_m))
        if side_m[0] > side_m[1]:
            side_m = (limits.side_min_m, limits.side_max_m)
        self._first = layouts.Sizes(side_m, (limits.height_min_m, limits.height_max_m))
        self._archive: dict[Cell, Elite] = {}
        self._chosen_times: dict[str, int] = {}
        self._placed: dict[str, int] = {}
        self._flown = 0

    # ---- tell --------------------------------------------------------------------------------------------------

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Place flown layouts in the archive and credit their parents."""
        for outcome in outcomes:
            layout = outcome.test_case.scenario.obstacles
            if outcome.ending not in FLOWN_ENDINGS or outcome.guidance is None or len(layout) != BOXES:
                continue
            self._flown += 1
            parent = outcome.test_case.origin.parent
            placed = self._place(outcome)
            if parent:
                self._chosen_times[parent] = self._chosen_times.get(parent, 0) + 1
                self._placed[parent] = self._placed.get(parent, 0) + placed

    def _place(self, outcome: Outcome) -> bool:
        assert outcome.guidance is not None, "only flights that said something are placed"
        fitness_m = outcome.features.get("min_distance_m", outcome.guidance)
        cell = self.cell(outcome.test_case.scenario.obstacles)
        held = self._archive.get(cell)
        if held is not None and held.fitness_m <= fitness_m:
            return False
        self._archive[cell] = Elite(outcome.test_case, identity(outcome.test_case), fitness_m)
        return True

    def cell(self, layout: Sequence[Obstacle]) -> Cell:
        """Return the archive cell of two boxes: distance of the centres, angle of the line between them (0..180)."""
        dx, dy = layout[1].x_m - layout[0].x_m, layout[1].y_m - layout[0].y_m
        cells = self._chosen.whole("cells")
        angle = math.degrees(math.atan2(dy, dx)) % 180.0
        return (
            min(cells - 1, int(math.hypot(dx, dy) / DISTANCE_MAX_M * cells)),
            min(cells - 1, int(angle / 180.0 * cells)),
        )

    # ---- ask ---------------------------------------------------------------------------------------------------

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` layouts: random ones until the first population has flown, then children of elites."""
        if self._flown < self._chosen.whole("population") or not self._archive:
            return [self._random(rng) for _ in range(count)]
        elites = [self._archive[cell] for cell in sorted(self._archive)]
        ranked = sorted(elites, key=lambda elite: (-self._contribution(elite), draw_key(elite.test_case)))
        return [self._child(rng, elites, ranked) for _ in range(count)]

    def _random(self, rng: np.random.Generator) -> TestCase:
        layout = None
        if rng.random() < self._chosen.real("gates"):
            layout = layouts.astride(rng, self._mission, self._first, self._rules, layouts.Gate())
        if layout is None:
            place = _shared(FIRST_PLACE, self._rules.area)
            layout = layouts.anywhere(rng, BOXES, self._first, place, self._rules)
        return self._made(layout, parent="", note="random")

    def _contribution(self, elite: Elite) -> float:
        times = self._chosen_times.get(elite.identity, 0)
        return self._placed.get(elite.identity, 0) / times if times else 1.0

    def _child(self, rng: np.random.Generator, elites: list[Elite], ranked: list[Elite]) -> TestCase:
        for _ in range(TRIES):
            if rng.random() < self._chosen.real("rank_share"):
                parent = ranked[rank_index(rng.random(), len(ranked), self._chosen.real("rank_bias"))]
            else:
                parent = elites[int(rng.integers(len(elites)))]
            child = mutate(rng, parent.test_case.scenario.obstacles, self._rules)
            if child is not None:
                layout, note = child
                return self._made(layout, parent.identity, note)
        return self._random(rng)

    def _made(self, layout: tuple[Obstacle, ...], parent: str, note: str) -> TestCase:
        scenario = msgspec.structs.replace(self._template.scenario, obstacles=layout)
        origin = Origin(strategy="deephyperion", parent=parent, note=note)
        return msgspec.structs.replace(self._template, scenario=scenario, origin=origin)


def _shared(place: Area, area: Area) -> Area:
    """Return the part of `place` that lies in `area`, all of `area` if there is none."""
    part = Area(
        max(place.x_min_m, area.x_min_m),
        min(place.x_max_m, area.x_max_m),
        max(place.y_min_m, area.y_min_m),
        min(place.y_max_m, area.y_max_m),
    )
    return part if part.x_min_m < part.x_max_m and part.y_min_m < part.y_max_m else area


def rank_index(draw: float, count: int, bias: float) -> int:
    """Return the index drawn by linear ranking (Whitley 1989, GENITOR) for a uniform `draw` in 0..1."""
    share = (bias - math.sqrt(bias * bias - 4.0 * (bias - 1.0) * draw)) / (2.0 * (bias - 1.0))
    return min(count - 1, int(count * share))


def mutate(
    rng: np.random.Generator, parent: Sequence[Obstacle], rules: boxes.Rules
) -> tuple[tuple[Obstacle, ...], str] | None:
    """Return a child that differs from the parent in one attribute of one box, and a note saying which.

    None if none of the tries kept the rules. Every try starts from the parent.
    """
    for _ in range(TRIES):
        index = int(rng.integers(len(parent)))
        attribute = boxes.ATTRIBUTES[int(rng.integers(len(boxes.ATTRIBUTES)))]
        step = rng.uniform(*(TURN_DEG if attribute == "rotation_deg" else MOVE_M)) * (1 if rng.random() < 0.5 else -1)
        box = boxes.nudge(parent[index], attribute, float(step))
        others = [other for place, other in enumerate(parent) if place != index]
        if boxes.allowed(box, others, rules):
            return boxes.replace_at(parent, index, box), f"box {index + 1} {attribute} {step:+.2f}"
    return None
