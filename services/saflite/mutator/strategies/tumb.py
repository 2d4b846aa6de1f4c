"""TUMB: Monte-Carlo tree search over layouts; a child is its parent with one box more, put on the way that was flown.

A node is a layout of 0 to 4 boxes and the track of its flight. From the root the search goes to the child with the best
mean reward (less distance is better) and a bonus for what was seldom tried, and expands the first node with few enough
children for its visits. The new box lies in the largest free circle about a point of the node's track.

Mended against the published tool (`published=1` is as it was, but for nodes of four boxes, which it flies again): the
value of a node is the best below it, as the tool's paper says (there, rewards are summed); sides and clearances keep
the competition's rules (28 of 38 published tests have a side under 2 m); what is broken is not built upon; a point
without room costs another draw, not the run; and the bare mission's way needs no flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import msgspec
import numpy as np

from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Obstacle, Origin, TestCase, identity
from saflite.contract.work import Outcome
from saflite.mutator.operators import boxes, circles, layouts, tracks
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

ROOT = ""
CHILDREN = (0.4, 0.5, 0.6, 0.7)  # so many times the root of its visits a node of 0, 1, 2, 3 boxes may have children
EXPLORATION = 1 / math.sqrt(2)
FIRST_Y_MAX_M = 15.0  # the first box stands on the way before this
FAR_M = 50.0  # distances beyond count as this
TRIES = 60


@dataclass(slots=True)
class Node:
    """One layout: `rewards` of it and of all below it that were flown, best and sum."""

    layout: tuple[Obstacle, ...]
    track: tracks.Track
    parent: str = ROOT
    visits: int = 0
    reward_sum: float = 0.0
    reward_max: float = -math.inf
    children: list[str] = field(default_factory=list)
    is_broken: bool = False


class Strategy:
    """The tree."""

    proposes: ClassVar[Proposes] = "obstacles"
    options: ClassVar[Options] = {
        "published": Option(0, "1: as the published tool", 0, 1),
        "siblings": Option(5, "candidates in a row that are children of the same node", 1, 1000),
        **layouts.RULE_OPTIONS,
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings; raises Refused for a bad one, no mission, or a target that minds no boxes."""
        self._chosen = Chosen(settings, self.options)
        self._published = self._chosen.flag("published")
        self._template = template
        mission = layouts.mission_of(template.scenario.mission, target)
        self._rules = layouts.rules_of(self._chosen, mission)
        self._nodes: dict[str, Node] = {ROOT: Node((), tracks.planned(mission))}
        self._root_known = not self._published  # the published tool flies the bare mission first

    # ---- tell --------------------------------------------------------------------------------------------------

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Grow the tree by what was flown and tell every node above."""
        for outcome in outcomes:
            layout = outcome.test_case.scenario.obstacles
            flown = outcome.ending in FLOWN_ENDINGS and outcome.guidance is not None
            if not layout:
                root = self._nodes[ROOT]
                root.track = (tracks.flown(outcome) or root.track) if flown else root.track
                self._root_known = True
                continue
            parent, name = outcome.test_case.origin.parent, identity(outcome.test_case)
            above = self._nodes.get(parent)
            if above is None or len(above.layout) != len(layout) - 1 or name in self._nodes:
                continue
            reward = _reward(outcome) if flown else 0.0
            if flown or self._published:
                self._grow(outcome, name, parent, reward)
                self._credit(parent if name not in self._nodes else name, reward)

    def _grow(self, outcome: Outcome, name: str, parent: str, reward: float) -> None:
        if self._published and reward == 0.0:  # deleted there: a flight that failed, and a perfect collision as well
            return
        track = tracks.flown(outcome) or self._nodes[parent].track
        layout = outcome.test_case.scenario.obstacles
        broken = bool(outcome.violated) and not self._published
        self._nodes[name] = Node(layout, track, parent, is_broken=broken)
        self._nodes[parent].children.append(name)

    def _credit(self, name: str, reward: float) -> None:
        while True:
            node = self._nodes[name]
            node.visits += 1
            node.reward_sum += reward
            node.reward_max = max(node.reward_max, reward)
            if name == ROOT:
                return
            name = node.parent

    # ---- ask ---------------------------------------------------------------------------------------------------

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` layouts, `siblings` in a row from one node; each group counts as a visit to the next."""
        if not self._root_known:
            return [self._made((), ROOT, "the bare mission")] * count
        siblings = count if self._published else self._chosen.whole("siblings")
        assumed: dict[str, int] = {}
        cases: list[TestCase] = []
        while len(cases) < count:
            name = self.select(assumed)
            cases += [self._expanded(rng, name) for _ in range(min(siblings, count - len(cases)))]
            self._assume(assumed, name)
        return cases

    def select(self, assumed: dict[str, int] | None = None) -> str:
        """Return the node to expand; `assumed` counts visits that have not been told of yet."""
        more = assumed or {}
        name = ROOT
        while True:
            node = self._nodes[name]
            visits = node.visits + more.get(name, 0)
            below = [child for child in node.children if self._may_descend(child)]
            if not below or len(node.children) <= CHILDREN[len(node.layout)] * math.sqrt(visits):
                return name
            name = max(below, key=lambda child: self._bound(child, visits, more.get(child, 0)))

    def _may_descend(self, name: str) -> bool:
        node = self._nodes[name]
        return len(node.layout) < layouts.COUNT_MAX and not node.is_broken

    def _bound(self, name: str, visits: int, more: int) -> float:
        """Return the upper confidence bound of a child (Kocsis & Szepesvari 2006)."""
        node = self._nodes[name]
        value = node.reward_sum / node.visits if self._published else node.reward_max
        return value + EXPLORATION * math.sqrt(2.0 * math.log(max(1, visits)) / (node.visits + more))

    def _assume(self, assumed: dict[str, int], name: str) -> None:
        while True:
            assumed[name] = assumed.get(name, 0) + 1
            if name == ROOT:
                return
            name = self._nodes[name].parent

    def _expanded(self, rng: np.random.Generator, name: str) -> TestCase:
        while True:
            node = self._nodes[name]
            box = self._box(rng, node)
            if box is not None:
                return self._made((*node.layout, box), name, f"box {len(node.layout) + 1}")
            if name == ROOT:
                limits = self._rules.sizes
                sizes = layouts.Sizes(
                    (limits.side_min_m, limits.side_max_m), (limits.height_min_m, limits.height_max_m)
                )
                return self._made(layouts.anywhere(rng, 1, sizes, self._rules.area, self._rules), ROOT, "anywhere")
            name = node.parent

    def _box(self, rng: np.random.Generator, node: Node) -> Obstacle | None:
        """Return one box more for a node, None if none of the tries finds room."""
        points = places(node.track, self._rules, bool(node.layout))
        for _ in range(TRIES if points else 0):
            point = points[int(rng.integers(len(points)))]
            radius_m = circles.draw_radius(rng, point, node.layout, self._rules.area)
            if radius_m <= 0.0:
                continue
            box = circles.draw_inside(rng, point, radius_m)
            if self._published:
                return box
            box = boxes.tidy(msgspec.structs.replace(box, height_m=min(box.height_m, self._rules.sizes.height_max_m)))
            if boxes.allowed(box, node.layout, self._rules):
                return box
        return None

    def _made(self, layout: tuple[Obstacle, ...], parent: str, note: str) -> TestCase:
        scenario = msgspec.structs.replace(self._template.scenario, obstacles=layout)
        origin = Origin(strategy="tumb", parent=parent, note=note)
        return msgspec.structs.replace(self._template, scenario=scenario, origin=origin)


def places(track: tracks.Track, rules: boxes.Rules, is_later: bool) -> list[tracks.Point]:
    """Return where the next box may be centred: points of the track in the area, for the first box early ones."""
    inside = [point for point in track if tracks.within(point, rules.area)]
    late = next((n for n, point in enumerate(track) if point[1] > FIRST_Y_MAX_M), len(track))
    early = [point for point in track[:late] if tracks.within(point, rules.area)]
    return inside if is_later else early or inside


def _reward(outcome: Outcome) -> float:
    assert outcome.guidance is not None, "only flights that said something have a reward"
    return -min(FAR_M, outcome.features.get("min_distance_m", outcome.guidance))
