"""Inputs drawn at random, and variations of test cases that came near to a violation: a strategy to begin with.

saflite conformance strategy NAME --module NAME.py
saflite run policy-upright --strategy NAME --module NAME.py --set inputs_max=6
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import Origin, Stimulus, TestCase
from saflite.contract.work import Outcome
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

KEPT = 20


class Strategy:
    """Asked for test cases and told what became of them; it may keep nothing but what it was told."""

    proposes: ClassVar[Proposes] = "stimuli"
    options: ClassVar[Options] = {
        "inputs_max": Option(4, "greatest number of inputs in a test case", 1, 50),
        "varied": Option(0.5, "share of test cases that vary an earlier one", 0, 1),
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings; raises Refused for a bad one, or a target without inputs."""
        self._chosen = Chosen(settings, self.options)
        self._template = template
        if template.scenario.mission is None and template.scenario.start is None:
            raise Refused("strategy", expected="a campaign with a mission or a start state", got="neither")
        self._inputs = tuple(one for one in target.inputs if one.kind in ("parameter", "stick", "mode"))
        if not self._inputs:
            raise Refused("strategy", expected="a target that takes inputs", got=f"{target.name}, which takes none")
        self._near: list[tuple[float, TestCase]] = []

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Keep the test cases that came nearest to a violation."""
        for one in outcomes:
            if one.robustness is not None:
                self._near.append((one.robustness, one.test_case))
        self._near = sorted(self._near, key=lambda pair: pair[0])[:KEPT]

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return test cases; every random draw comes from `rng`, so that a run can be repeated."""
        return [self._next(rng) for _ in range(count)]

    def _next(self, rng: np.random.Generator) -> TestCase:
        vary = bool(self._near) and rng.random() < self._chosen.real("varied")
        base = self._near[rng.integers(len(self._near))][1] if vary else self._template
        kept = [one for one in base.stimuli if rng.random() < 0.8]
        room = self._chosen.whole("inputs_max")
        new = [self._draw(rng) for _ in range(int(rng.integers(1, room + 1)))]
        stimuli = tuple(sorted((*kept[: room - 1], *new)[:room], key=lambda one: one.at_s))
        origin = Origin(strategy=Path(__file__).stem, note="varied" if vary else "fresh")
        return msgspec.structs.replace(self._template, stimuli=stimuli, origin=origin)

    def _draw(self, rng: np.random.Generator) -> Stimulus:
        one = self._inputs[rng.integers(len(self._inputs))]
        at_s = 0.0 if one.at_start else round(float(rng.uniform(0.0, 0.6 * self._template.scenario.time_limit_s)), 2)
        values = () if one.kind == "mode" else (_value(one, rng),)
        return Stimulus(at_s=at_s, kind=one.kind, name=one.name, values=values)


def _value(one: InputInfo, rng: np.random.Generator) -> float:
    """Return a value within the documented range, or near the default where none is known."""
    if one.choices:
        return float(one.choices[rng.integers(len(one.choices))])
    middle = one.default or 0.0
    low = middle - 1.0 if one.low is None else one.low
    high = middle + 1.0 if one.high is None else one.high
    value = float(rng.uniform(low, high))
    return float(round(value)) if one.type in ("whole", "flag") else round(value, 3)
