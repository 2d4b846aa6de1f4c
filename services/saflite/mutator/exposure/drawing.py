"""Drawing inputs for a policy: kinds left out of a test case, names from its own list or all there are, values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from saflite.contract.test_case import Stimulus, StimulusKind
from saflite.mutator.exposure import numbers
from saflite.mutator.exposure.hints import Hint
from saflite.mutator.exposure.vocabulary import ENDS, Vocabulary
from saflite.mutator.operators.inputs import Input

Rng = np.random.Generator
SPARED = 0.8  # share of times something else is drawn than what may end a flight, where the rule is not about it
MODES_WITHIN = 0.15  # share of test cases that change the mode within a phase, too


class Style(NamedTuple):
    """What the inputs of one phase have in common: whose they are, the kinds that are not left out, the mode."""

    hint: Hint
    kinds: tuple[StimulusKind, ...]
    mode: str = ""


class Shares(NamedTuple):
    """The strategy's settings of these names."""

    own: float
    swarm: float
    faults: float
    beyond: float


class Drawing:
    """Draws from a vocabulary; `rest` holds the values at which inputs rest."""

    def __init__(self, vocabulary: Vocabulary, rest: Mapping[tuple[StimulusKind, str], float], shares: Shares) -> None:
        self._vocabulary, self._rest, self._shares = vocabulary, rest, shares

    def style(self, rng: Rng, hint: Hint) -> Style:
        """Draw which kinds of input a test case has (modes aside, which begin its phases)."""
        kinds, swarm = self._vocabulary.kinds, self._shares.swarm
        chances = {kind: swarm if kind in hint.kinds() else swarm / 2.0 for kind in kinds}
        if "sensor_fault" not in hint.kinds():
            chances["sensor_fault"] = swarm * self._shares.faults
        chances["mode"] = MODES_WITHIN
        kept = tuple(kind for kind in kinds if rng.random() < chances[kind])
        return Style(hint, kept or (kinds[int(rng.integers(len(kinds)))],))

    def draw(self, style: Style, rng: Rng) -> Stimulus:
        """Return an input for a test case of a style; its time does not matter."""
        entry = None
        if rng.random() < self._shares.own:
            entry = self._vocabulary.draw_own(rng, style.hint, style.kinds, style.mode)
        if entry is None:
            entry = self._vocabulary.draw(rng, style.hint.policy, style.kinds, style.mode)
            if entry.name in ENDS and rng.random() < SPARED:
                entry = self._vocabulary.draw(rng, style.hint.policy, style.kinds, style.mode)
        return self.given(rng, entry)

    def seldom(self, rng: Rng, mode: str) -> Stimulus | None:
        """Return an input that was given seldom in a mode, None where nothing acts at once."""
        entry = self._vocabulary.draw_seldom(rng, mode)
        return self.given(rng, entry) if entry is not None else None

    def pushed(self, rng: Rng, entry: Input, sense: float) -> float:
        """Return a value of a setting well off where it rests, up or down."""
        return numbers.pushed(rng, entry, self._rest.get((entry.kind, entry.name)), sense)

    def moved(self, rng: Rng, entry: Input) -> Stimulus:
        """Return a setting off its default."""
        value = numbers.moved(rng, entry, self._rest.get((entry.kind, entry.name)))
        return _stimulus(entry, (value,))

    def at_rest(self, rng: Rng, entry: Input) -> Stimulus:
        """Return an input with the value at which it rests, or any where that is not known."""
        rest = self._rest.get((entry.kind, entry.name))
        return self.given(rng, entry) if rest is None else _stimulus(entry, (rest,))

    def given(self, rng: Rng, entry: Input) -> Stimulus:
        """Return an input with values, rather not those that it has at rest."""
        default = self._rest.get((entry.kind, entry.name))
        given = numbers.draw(rng, entry, default, self._shares.beyond)
        if given == (default,):  # what is so already changes nothing
            given = numbers.draw(rng, entry, default, self._shares.beyond)
        return _stimulus(entry, given)


def _stimulus(entry: Input, given: tuple[float, ...]) -> Stimulus:
    return Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=given)
