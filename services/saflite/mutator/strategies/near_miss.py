"""Local search from near misses: layouts whose flight came close but not too close are moved a little.

Most flights around boxes keep a margin of a few decimetres over the limit, so a small change of a near miss breaks it
far more often than a fresh layout does. The closest flights are kept, one per kind of layout (centres on a grid); a
child moves, turns or resizes one box, or shifts the whole layout. A layout that has been broken, and the parent it came
from, are done with: the search goes on elsewhere, so that what it finds is different. The rest are fresh layouts as
`random_boxes` draws them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np

from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Obstacle, Origin, TestCase, draw_key, identity
from saflite.contract.work import Outcome
from saflite.mutator.operators import boxes, layouts
from saflite.mutator.strategies import random_boxes
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

TRIES = 100
SHIFT_SHARE = 0.2  # children that shift the whole layout instead of changing one box
PATIENCE_M = 0.15  # a parent counts as this much farther away for every child that was no better

Layout = tuple[Obstacle, ...]
Cell = tuple[tuple[int, int], ...]


class NearMiss(NamedTuple):
    """A flight that came close without violating."""

    layout: Layout
    identity: str
    draw_key: str
    margin: float


class Strategy:
    """The near misses and how often each was tried in vain."""

    proposes: ClassVar[Proposes] = "obstacles"
    options: ClassVar[Options] = {
        "population": Option(16, "fresh layouts flown before the first child", 1, 10_000),
        "fresh": Option(0.25, "share of fresh layouts after that", 0, 1),
        "kept": Option(16, "how many near misses are kept", 1, 1000),
        "grid_m": Option(5.0, "layouts with all centres in the same cells of this size are one kind", 0.5, 50),
        "move_m": Option(1.5, "typical change of a position or side", 0.01, 20),
        "turn_deg": Option(12.0, "typical change of a rotation", 0.1, 90),
        **random_boxes.Strategy.options,
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings; raises Refused for a bad one, no mission, or a target that minds no boxes."""
        self._chosen = Chosen(settings, self.options)
        theirs = {name: value for name, value in settings.items() if name in random_boxes.Strategy.options}
        self._fresh = random_boxes.Strategy(template, theirs, policies, target)
        self._template = template
        self._rules = layouts.rules_of(self._chosen, layouts.mission_of(template.scenario.mission, target))
        self._kept: dict[Cell, NearMiss] = {}
        self._in_vain: dict[str, int] = {}
        self._done: set[Cell] = set()
        self._cell_of: dict[str, Cell] = {}
        self._flown = 0

    # ---- tell --------------------------------------------------------------------------------------------------

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Keep near misses; what was broken, and its parent, are done with."""
        for _, of_round in groupby(outcomes, key=lambda outcome: outcome.round):
            self._tell_round(of_round)

    def _tell_round(self, outcomes: Iterable[Outcome]) -> None:
        """Learn from one round, then drop what is beyond `kept`: however many rounds are told at once."""
        for outcome in outcomes:
            layout = outcome.test_case.scenario.obstacles
            if outcome.ending not in FLOWN_ENDINGS or outcome.guidance is None or not layout:
                continue
            self._flown += 1
            self._learn(outcome, outcome.guidance)
        excess = sorted(self._kept, key=lambda cell: (self._worth(self._kept[cell]), cell))[
            self._chosen.whole("kept") :
        ]
        for cell in excess:
            del self._kept[cell]

    def _learn(self, outcome: Outcome, margin: float) -> None:
        case = outcome.test_case
        name, parent, cell = identity(case), case.origin.parent, self._cell(case.scenario.obstacles)
        self._cell_of[name] = cell
        if outcome.violated:
            for done in (cell, self._cell_of.get(parent)):
                if done is not None:
                    self._done.add(done)
                    self._kept.pop(done, None)
            return
        held = self._kept.get(cell)
        if cell not in self._done and (held is None or margin < held.margin):
            self._kept[cell] = NearMiss(case.scenario.obstacles, name, draw_key(case), margin)
        elif parent:
            self._in_vain[parent] = self._in_vain.get(parent, 0) + 1

    def _cell(self, layout: Layout) -> Cell:
        grid = self._chosen.real("grid_m")
        return tuple(sorted((int(box.x_m // grid), int(box.y_m // grid)) for box in layout))

    def _worth(self, miss: NearMiss) -> float:
        return miss.margin + PATIENCE_M * self._in_vain.get(miss.identity, 0)

    # ---- ask ---------------------------------------------------------------------------------------------------

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` layouts: fresh ones until the first population has flown, then mostly children."""
        if self._flown < self._chosen.whole("population") or not self._kept:
            return [self._named(case) for case in self._fresh.ask(count, rng)]
        ranked = sorted(self._kept.values(), key=lambda miss: (self._worth(miss), miss.draw_key))
        return [self._one(rng, ranked) for _ in range(count)]

    def _one(self, rng: np.random.Generator, ranked: list[NearMiss]) -> TestCase:
        if rng.random() >= self._chosen.real("fresh"):
            parent = ranked[min(len(ranked) - 1, int(len(ranked) * rng.random() ** 2))]  # the close ones more often
            child = self._child(rng, parent.layout)
            if child is not None:
                scenario = msgspec.structs.replace(self._template.scenario, obstacles=child)
                origin = Origin(strategy="near_miss", parent=parent.identity, note="child")
                return msgspec.structs.replace(self._template, scenario=scenario, origin=origin)
        return self._named(self._fresh.ask(1, rng)[0])

    def _named(self, case: TestCase) -> TestCase:
        return msgspec.structs.replace(case, origin=msgspec.structs.replace(case.origin, strategy="near_miss"))

    def _child(self, rng: np.random.Generator, parent: Layout) -> Layout | None:
        """Return a changed layout that keeps the rules, None if none of the tries does."""
        for _ in range(TRIES):
            child = self._shifted(rng, parent) if rng.random() < SHIFT_SHARE else self._nudged(rng, parent)
            if child != parent and all(
                boxes.allowed(box, child[:place], self._rules) for place, box in enumerate(child)
            ):
                return child
        return None

    def _nudged(self, rng: np.random.Generator, parent: Layout) -> Layout:
        index = int(rng.integers(len(parent)))
        attribute = boxes.ATTRIBUTES[int(rng.integers(len(boxes.ATTRIBUTES)))]
        size = self._chosen.real("turn_deg" if attribute == "rotation_deg" else "move_m")
        box = boxes.nudge(parent[index], attribute, float(rng.normal(0.0, size)))
        return boxes.replace_at(parent, index, box)

    def _shifted(self, rng: np.random.Generator, parent: Layout) -> Layout:
        size = self._chosen.real("move_m")
        dx, dy = (float(step) for step in rng.normal(0.0, size, size=2))
        return tuple(boxes.nudge(boxes.nudge(box, "x_m", dx), "y_m", dy) for box in parent)
