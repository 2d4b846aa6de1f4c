"""What every strategy is: an ask/tell state machine over a seed pool, with documented settings.

State depends on what was told only: asking twice changes nothing, and telling everything again to a new instance
gives the same strategy. That is what lets a mutator restart from zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal, NamedTuple, Protocol

import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Setting, TestCase
from saflite.contract.work import Outcome

Proposes = Literal["obstacles", "stimuli"]


class Option(NamedTuple):
    """One setting of a strategy: its default (whose type it must have), range, and meaning."""

    default: Setting
    meaning: str
    least: float = float("-inf")
    most: float = float("inf")


Options = dict[str, Option]
Settings = dict[str, Setting]


class Strategy(Protocol):
    """One way to search. Its file stands in `mutator/strategies/` and defines `class Strategy`.

    `target` says what can be given to the target. Raises Refused when made with an unknown setting, a value out of
    range, a template it cannot mutate, or a target that has nothing for it.
    """

    proposes: ClassVar[Proposes]
    options: ClassVar[Options]

    def __init__(
        self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo
    ) -> None: ...

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Learn what became of flown test cases, in (round, index) order."""
        ...

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` test cases to consider next."""
        ...


class Chosen:
    """The settings in force: what was given, defaults for the rest; typed readers so that faults are named."""

    def __init__(self, given: Settings, options: Options) -> None:
        for name, value in given.items():
            _check(name, value, options)
        defaults: Settings = {name: option.default for name, option in options.items()}
        self._values: Settings = defaults | given

    def real(self, name: str) -> float:
        """Return a number."""
        value = self._values[name]
        assert isinstance(value, int | float), f"setting {name} is no number"
        return float(value)

    def whole(self, name: str) -> int:
        """Return a whole number."""
        return int(self.real(name))

    def flag(self, name: str) -> bool:
        """Return a yes or no."""
        return bool(self._values[name])

    def text(self, name: str) -> str:
        """Return a word."""
        return str(self._values[name])

    def numbers(self, name: str) -> list[float]:
        """Return a list of numbers; raises Refused for what is none."""
        value = self._values[name]
        assert isinstance(value, list), f"setting {name} is no list"
        wrong = [part for part in value if isinstance(part, bool) or not isinstance(part, int | float)]
        if wrong:
            raise Refused(f"strategy setting {name}", expected="numbers", got=repr(wrong[0]))
        return [float(part) for part in value if isinstance(part, int | float)]

    def words(self, name: str) -> list[str]:
        """Return a list of words."""
        value = self._values[name]
        assert isinstance(value, list), f"setting {name} is no list"
        return [str(word) for word in value]


def _check(name: str, value: Setting, options: Options) -> None:
    where = f"strategy setting {name}"
    if name not in options:
        raise Refused("strategy setting", expected=f"one of {', '.join(sorted(options))}", got=repr(name))
    option = options[name]
    kind = type(option.default)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not kind:
        raise Refused(where, expected=f"a value like {option.default!r}", got=repr(value))
    if isinstance(value, int | float) and not option.least <= value <= option.most:
        raise Refused(where, expected=f"{option.least:g} to {option.most:g}", got=value)
