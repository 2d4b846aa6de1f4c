"""CAMBA: two boxes astride the vehicle's way, closed where it flew between them and opened where it did not.

A point of the way is drawn, a pair of boxes built about it with a gap of 5.6 to 7.8 m, and flown. Where the vehicle
passed decides the next pair: between the boxes, both move inwards; beside one, that one moves outwards and is turned
or lengthened, so that the gap looks better than the way round. A pair that is broken is done with; a new point follows.

Mended against the published tool (`published=1` is as it was): changed pairs keep the competition's rules, rotation
within 0 to 90 degrees, steps vary so that there is something to choose from, several pairs are followed at once, a
share of pairs is fresh, a pair that comes no closer is given up, and the way comes from the mission, which costs no
flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple, cast

import msgspec
import numpy as np

from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Obstacle, Origin, TestCase, identity
from saflite.contract.work import Outcome
from saflite.flight.geometry import Area
from saflite.mutator.operators import boxes, layouts, pairs, tracks
from saflite.mutator.operators.pairs import Anchor, Pair, Where
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

PLACE = Area(-30.0, 20.0, 23.0, 27.0)  # where the published tool takes points of the way from
SCALE = (0.5, 1.5)  # of a published step
TRIES = 20


class Head(NamedTuple):
    """The last flown pair of a chain: what to change next, and for how many flights it came no closer."""

    test_case: TestCase
    pair: Pair
    anchor: Anchor
    passed: Where
    closest_m: float
    in_vain: int


class Strategy:
    """The pairs that are being followed."""

    proposes: ClassVar[Proposes] = "obstacles"
    options: ClassVar[Options] = {
        "published": Option(0, "1: as the published tool, one pair at a time", 0, 1),
        "fresh": Option(0.25, "share of pairs about a new point while others are followed", 0, 1),
        "chains": Option(8, "how many pairs are followed at once", 1, 1000),
        "patience": Option(6, "flights after which a pair that came no closer is given up", 1, 1000),
        **layouts.RULE_OPTIONS,
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings; raises Refused for a bad one, no mission, or a target that minds no boxes."""
        self._chosen = Chosen(settings, self.options)
        self._published = self._chosen.flag("published")
        self._template = template
        mission = layouts.mission_of(template.scenario.mission, target)
        self._rules = layouts.rules_of(self._chosen, mission)
        self._way = tracks.planned(mission)
        self._way_known = not self._published  # the published tool flies the bare mission first
        self._heads: dict[str, Head] = {}

    # ---- tell --------------------------------------------------------------------------------------------------

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Follow the pairs that were flown; what was broken or could not be flown is done with."""
        for outcome in outcomes:
            flown = outcome.ending in FLOWN_ENDINGS and outcome.guidance is not None
            if not outcome.test_case.scenario.obstacles:
                self._way = (tracks.flown(outcome) or self._way) if flown else self._way
                self._way_known = True
                continue
            anchor = anchor_in(outcome.test_case.origin.note)
            if anchor is None or len(outcome.test_case.scenario.obstacles) != 2:
                continue
            parent = self._heads.pop(outcome.test_case.origin.parent, None)
            if self._published:
                self._heads.clear()
            if flown and not outcome.violated:
                self._follow(outcome, anchor, parent)

    def _follow(self, outcome: Outcome, anchor: Anchor, parent: Head | None) -> None:
        assert outcome.guidance is not None, "only flights that said something are followed"
        distance_m = outcome.features.get("min_distance_m", outcome.guidance)
        closer = parent is None or distance_m < parent.closest_m
        in_vain = 0 if closer or parent is None else parent.in_vain + 1
        if not self._published and in_vain >= self._chosen.whole("patience"):
            return
        layout = cast(Pair, outcome.test_case.scenario.obstacles)
        pair = layout if self._published else pairs.untidied(layout, anchor.up)
        passed = pairs.where(tracks.flown(outcome), pair, anchor.up)
        closest_m = distance_m if parent is None else min(distance_m, parent.closest_m)
        self._heads[identity(outcome.test_case)] = Head(outcome.test_case, pair, anchor, passed, closest_m, in_vain)
        while len(self._heads) > self._chosen.whole("chains"):
            del self._heads[next(iter(self._heads))]

    # ---- ask ---------------------------------------------------------------------------------------------------

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` pairs: changes of those that are followed, in turn, and fresh ones."""
        if not self._way_known:
            return [self._made((), "", "the bare mission")] * count
        heads = list(self._heads.values())
        fresh = 0.0 if self._published else self._chosen.real("fresh")
        cases = []
        for number in range(count):
            follow = bool(heads) and rng.random() >= fresh
            cases.append(self._next(rng, heads[number % len(heads)]) if follow else self._fresh(rng))
        return cases

    def _next(self, rng: np.random.Generator, head: Head) -> TestCase:
        parent = identity(head.test_case)
        if head.passed == "nowhere":
            return self._about(rng, head.anchor, self._near(head.anchor), parent)
        if self._published:
            return self._paired(pairs.moved(head.pair, head.passed, head.anchor.up), head.anchor, parent, head.passed)
        for _ in range(TRIES):
            pair = pairs.moved(head.pair, head.passed, head.anchor.up, float(rng.uniform(*SCALE)))
            if pairs.fits(pair, self._rules):
                return self._paired(pair, head.anchor, parent, head.passed)
        return self._fresh(rng)

    def _fresh(self, rng: np.random.Generator) -> TestCase:
        places = pairs.anchors(self._way, PLACE) or pairs.anchors(self._way, self._rules.area)
        for _ in range(TRIES if places else 0):
            index = places[int(rng.integers(len(places)))]
            near = pairs.local(self._way, index)
            anchor = Anchor(round(self._way[index][0], 2), round(self._way[index][1], 2), pairs.rises(near))
            pair = pairs.draw(rng, anchor, near, self._rules.area, None if self._published else self._rules)
            if pair is not None:
                return self._paired(pair, anchor, "", "fresh")
        return self._made(self._anywhere(rng), "", "anywhere")

    def _about(self, rng: np.random.Generator, anchor: Anchor, near: tracks.Track, parent: str) -> TestCase:
        pair = pairs.draw(rng, anchor, near, self._rules.area, None if self._published else self._rules)
        return self._fresh(rng) if pair is None else self._paired(pair, anchor, parent, "nowhere")

    def _near(self, anchor: Anchor) -> tracks.Track:
        way = self._way
        index = min(range(len(way)), key=lambda n: _square(way[n][0] - anchor.x_m) + _square(way[n][1] - anchor.y_m))
        return pairs.local(way, index)

    def _anywhere(self, rng: np.random.Generator) -> tuple[Obstacle, ...]:
        limits = self._rules.sizes
        sizes = layouts.Sizes((limits.side_min_m, limits.side_max_m), (limits.height_min_m, limits.height_max_m))
        return layouts.anywhere(rng, 2, sizes, self._rules.area, self._rules)

    def _paired(self, pair: Pair, anchor: Anchor, parent: str, why: str) -> TestCase:
        layout = pair if self._published else tuple(boxes.tidy(box) for box in pair)
        return self._made(layout, parent, f"{note_of(anchor)} {why}")

    def _made(self, layout: tuple[Obstacle, ...], parent: str, note: str) -> TestCase:
        scenario = msgspec.structs.replace(self._template.scenario, obstacles=layout)
        origin = Origin(strategy="camba", parent=parent, note=note)
        return msgspec.structs.replace(self._template, scenario=scenario, origin=origin)


def _square(value: float) -> float:
    """Return a square, infinite where `value ** 2` would raise: anchors and tracks may have been anywhere."""
    return value * value


def note_of(anchor: Anchor) -> str:
    """Return an anchor in words: what a test case's origin says of it, so that telling it again is enough."""
    return f"{'up' if anchor.up else 'down'} {anchor.x_m:.2f} {anchor.y_m:.2f}"


def anchor_in(note: str) -> Anchor | None:
    """Return the anchor a note begins with, None where it names none."""
    words = note.split()
    if len(words) < 3 or words[0] not in ("up", "down"):
        return None
    try:
        anchor = Anchor(float(words[1]), float(words[2]), words[0] == "up")
    except ValueError:
        return None
    return anchor if math.isfinite(anchor.x_m) and math.isfinite(anchor.y_m) else None
