"""Random box layouts under the competition's rules; a share of them as gates or walls astride the mission's path.

Idea of the 2025 competition's winner (Pseudo-Random): draw many layouts, let a cheap scorer pick, fly the best.
Boxes are drawn evenly over the area, sides and heights evenly in their limits, rotation 0 to 90 degrees; whole
rotated boxes stay in the area, do not overlap, and keep clear of take-off, way-points and landing. Learns nothing.

A wall is a box across the path and another beside it, 5 to 8 m away: the vehicle takes neither the passage nor the way
round, gets stuck, and from pockets like that it collides. Such a gap is CAMBA's, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import msgspec
import numpy as np

from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Obstacle, Origin, TestCase
from saflite.contract.work import Outcome
from saflite.mutator.operators import layouts
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings


class Strategy:
    """Draws every test case anew."""

    proposes: ClassVar[Proposes] = "obstacles"
    options: ClassVar[Options] = {
        "boxes_min": Option(2, "least number of boxes", 1, layouts.COUNT_MAX),
        "boxes_max": Option(3, "greatest number of boxes", 1, layouts.COUNT_MAX),
        "gates": Option(0.5, "share of layouts that are two boxes astride the path", 0, 1),
        "walls": Option(0.0, "share of layouts that are a box across the path and a passage beside it", 0, 1),
        **layouts.RULE_OPTIONS,
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings; raises Refused for a bad one, no mission, or a target that minds no boxes."""
        chosen = Chosen(settings, self.options)
        layouts.in_order(chosen, "boxes_min", "boxes_max")
        self._template = template
        self._mission = layouts.mission_of(template.scenario.mission, target)
        self._rules = layouts.rules_of(chosen, self._mission)
        limits = self._rules.sizes
        self._sizes = layouts.Sizes((limits.side_min_m, limits.side_max_m), (limits.height_min_m, limits.height_max_m))
        self._count = (chosen.whole("boxes_min"), chosen.whole("boxes_max"))
        self._gates, self._walls = chosen.real("gates"), chosen.real("walls")

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Learn nothing: every draw is independent of what was flown."""

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` fresh layouts."""
        return [self._draw(rng) for _ in range(count)]

    def _draw(self, rng: np.random.Generator) -> TestCase:
        layout: tuple[Obstacle, ...] | None = None
        note = ""
        if self._walls and rng.random() < self._walls:
            boxes = layouts.count_between(rng, *self._count)
            layout, note = layouts.wall(rng, boxes, self._mission, self._sizes, self._rules), "wall"
        if layout is None and rng.random() < self._gates:
            layout, note = layouts.astride(rng, self._mission, self._sizes, self._rules, layouts.Gate()), "gate"
        if layout is None:
            boxes = layouts.count_between(rng, *self._count)
            layout, note = layouts.anywhere(rng, boxes, self._sizes, self._rules.area, self._rules), "anywhere"
        scenario = msgspec.structs.replace(self._template.scenario, obstacles=layout)
        origin = Origin(strategy="random_boxes", note=note)
        return msgspec.structs.replace(self._template, scenario=scenario, origin=origin)
