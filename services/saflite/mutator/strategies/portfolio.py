"""A bandit over strategies, its arms: what finds new behaviours or states for little flown time proposes more.

Every arm is told all outcomes, whoever proposed the test case: a near miss of one is a parent for another. Arms share
each round's test cases by Thompson sampling (`mutator/bandit.py`), and one scorer chooses among all of them, so the
share flown may differ from the share proposed. Credit: 1 for a behaviour that a flight was the first to show, `state`
for each state of the target it was the first to reach. Cost: simulated seconds of the flight and `overhead_s` more for
proposing, scoring and judging; never the time of a clock, so that one `--rng-seed` finds the same on any machine.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from saflite.contract.bounds import WORD_CHARS_MAX
from saflite.contract.errors import Refused
from saflite.contract.outside import assignment
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.work import Outcome
from saflite.mutator.bandit import Bandit
from saflite.mutator.registry import load_strategy, options_of, strategy_names
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings
from saflite.mutator.strategy import Strategy as AnyStrategy

NAME = "portfolio"
OF_BOXES = ("random_boxes", "near_miss", "deephyperion", "camba", "tumb")
OF_INPUTS = ("exposure", "pgfuzz", "messages")
ARMS, GIVEN = "strategy setting arms", "strategy setting given"
_NEXT = re.compile(r",(?=\s*\w+=)")  # a comma between two settings, not one in a list


def given_of(settings: Settings) -> list[Any]:
    """Return settings of another strategy as the setting `given` holds them."""
    return [f"{name}={json.dumps(value)}" for name, value in settings.items()]  # such JSON is TOML, too


def may_be_arm(name: str, settings: Settings) -> bool:
    """Return whether a strategy is one of those the setting `arms` names or, where it names none, one that may be."""
    named = settings.get("arms", [])
    usual = (*OF_BOXES, *OF_INPUTS)
    return name in ([str(text).partition(":")[0] for text in named] if isinstance(named, list) and named else usual)


class Place(NamedTuple):
    """What every strategy is made with beside its settings."""

    template: TestCase
    policies: tuple[str, ...]
    target: TargetInfo

    def make(self, name: str, settings: Settings) -> AnyStrategy:
        """Return a strategy; raises Refused for bad settings, or where it cannot search here."""
        return load_strategy(name)(self.template, settings, self.policies, self.target)


class Strategy:
    """The arms and what they earned."""

    proposes: ClassVar[Proposes] = "obstacles"
    options: ClassVar[Options] = {
        "arms": Option(
            [],
            "strategies, `NAME` or `NAME:SETTING=VALUE,...` each; none named: those that ship and can search here, of "
            "boxes where there is a mission, of inputs elsewhere and where `given` is for those",
        ),
        "given": Option([], "`SETTING=VALUE` each, for all arms that have the setting"),
        "state": Option(0.1, "worth of a new state of the target; that of a new behaviour is 1", 0, 100),
        "overhead_s": Option(60.0, "simulated seconds a flight costs beside its own: to propose, score, judge", 0, 1e4),
        "memory": Option(100.0, "flights after which what was earned counts half", 1, 1e6),
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings and make the arms.

        Raises Refused for a bad setting, an arm that is unknown, named twice or a portfolio itself, one that cannot
        search here, a setting for all that no arm has, and where no strategy can search.
        """
        self._chosen = Chosen(settings, self.options)
        place = Place(template, policies, target)
        given = dict(assignment(GIVEN, text) for text in self._chosen.words("given"))
        named = self._chosen.words("arms") or _usual(place, given)
        _check_given(given, {read_arm(text)[0] for text in named})
        self._arms: dict[str, AnyStrategy] = {}
        for text in named:
            if text in self._arms:
                raise Refused(ARMS, expected="each arm once", got=f"{text!r} twice")
            self._arms[text] = _arm(place, text, given)
        self._time_limit_s = template.scenario.time_limit_s
        self._bandit = Bandit(tuple(self._arms), self._chosen.real("memory"))
        self._states: set[str] = set()

    # ---- tell --------------------------------------------------------------------------------------------------

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Credit the arms that proposed, and tell every arm everything."""
        for outcome in outcomes:
            credit, arm = self._credit(outcome), outcome.test_case.origin.arm
            if arm in self._arms:
                self._bandit.tell(arm, credit, self._cost_s(outcome))
        for strategy in self._arms.values():
            strategy.tell(outcomes)

    def _credit(self, outcome: Outcome) -> float:
        reached = {state for step in outcome.transitions for state in (step.before, step.after)} - self._states
        self._states |= reached
        return outcome.founded + self._chosen.real("state") * len(reached)

    def _cost_s(self, outcome: Outcome) -> float:
        """Return the simulated seconds a test case cost; one without a result was waited for as long as may be."""
        return outcome.features.get("duration_s", self._time_limit_s) + self._chosen.real("overhead_s")

    # ---- ask ---------------------------------------------------------------------------------------------------

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` test cases, those of an arm together."""
        shares = self._bandit.shares(rng, count)
        return [
            _of(arm, case)
            for arm, strategy in self._arms.items()
            if shares[arm]
            for case in strategy.ask(shares[arm], rng)
        ]


def read_arm(text: str) -> tuple[str, Settings]:
    """Return the strategy and the settings an arm names; raises Refused for what is none, or a portfolio."""
    name, _, rest = text.partition(":")
    if name == NAME:
        raise Refused("arm", where=ARMS, expected="a strategy that is no portfolio itself", got=repr(text))
    if name not in strategy_names():
        known = ", ".join(one for one in strategy_names() if one != NAME)
        raise Refused(
            "arm", where=ARMS, expected=f"one of {known}", got=repr(name), fix="see `saflite list strategies`"
        )
    if len(text) > WORD_CHARS_MAX:
        got = f"{len(text)}; settings for all arms stand in `given`"
        raise Refused(f"arm {name}", where=ARMS, expected=f"at most {WORD_CHARS_MAX} characters", got=got)
    return name, dict(assignment(f"arm {name}", part.strip()) for part in _NEXT.split(rest) if part.strip())


def _arm(place: Place, text: str, given: Settings) -> AnyStrategy:
    name, own = read_arm(text)
    common = {setting: value for setting, value in given.items() if setting in options_of(name)}
    try:
        return place.make(name, {**common, **own})
    except Refused as fault:
        raise Refused(f"arm {name}", where=ARMS, expected="one that can work here", got=f"{fault}") from fault


def _usual(place: Place, given: Settings) -> list[str]:
    """Return the strategies that ship and can search here, of one kind; raises Refused if there is none."""
    faults: list[Refused] = []
    kinds = (OF_INPUTS,) if place.template.scenario.mission is None else (OF_BOXES, OF_INPUTS)
    able = [found for kind in kinds if (found := [name for name in kind if _is_able(place, name, faults)])]
    if not able:
        raise faults[0]
    return next((names for names in able if _settings_of(names) >= given.keys()), able[0])


def _is_able(place: Place, name: str, faults: list[Refused]) -> bool:
    try:
        place.make(name, {})
    except Refused as fault:
        faults.append(fault)
        return False
    return True


def _check_given(given: Settings, names: Iterable[str]) -> None:
    known = sorted(_settings_of(names))
    for setting in given:
        if setting not in known:
            raise Refused(GIVEN, expected=f"one of {', '.join(known)}", got=repr(setting))


def _settings_of(names: Iterable[str]) -> set[str]:
    return {setting for name in names for setting in options_of(name)}


def _of(arm: str, case: TestCase) -> TestCase:
    return msgspec.structs.replace(case, origin=msgspec.structs.replace(case.origin, strategy=NAME, arm=arm))
