"""Sequences of inputs in phases: into a state, a few inputs close together, then quiet, for rules that wait for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from saflite.contract.test_case import STIMULI_MAX, Stimulus, StimulusKind

Rng = np.random.Generator
Stimuli = tuple[Stimulus, ...]
Draw = Callable[[Rng], Stimulus]
"""Gives a fresh stimulus; its time does not matter."""

PAUSE_S = (0.1, 4.0)  # between the inputs of one phase; all sizes alike
TAIL_S = 6.0  # least time left after the last input, for its effect to show
MORE = 0.65  # chance of one more input in a phase
INPUTS_MAX = 6
QUIET_SHARE, QUIET_LONGER = 0.6, 1.5  # how often a phase lasts as long as the rule asks for, how much longer at most
RECOVER: dict[StimulusKind, float] = {"stick": 0.8, "sensor_fault": 0.5, "parameter": 0.1}
"""Chance that an input is taken back at the end of its phase: sticks let go, faults mended, settings reset."""


class Tempo(NamedTuple):
    """When inputs may be given: from `first_s` to `last_s`; a phase ends with `settle_s` of quiet; values at rest."""

    first_s: float
    last_s: float
    settle_s: tuple[float, float]
    rest: Mapping[tuple[StimulusKind, str], float]


class Script:
    """A sequence being written: stimuli so far and the time of the next."""

    def __init__(self, tempo: Tempo, stimuli: Sequence[Stimulus] = (), first_s: float | None = None) -> None:
        self._tempo = tempo
        self._stimuli = list(stimuli)
        self.at_s = tempo.first_s if first_s is None else first_s

    @property
    def is_full(self) -> bool:
        """Whether no time or room is left for another phase."""
        return self.at_s > self._tempo.last_s or len(self._stimuli) >= STIMULI_MAX

    def give(self, stimulus: Stimulus) -> None:
        """Add an input at the time reached."""
        if not self.is_full:
            self._stimuli.append(msgspec.structs.replace(stimulus, at_s=round(self.at_s, 2)))

    def pause(self, rng: Rng, low_s: float, high_s: float) -> None:
        """Let time go by, all sizes alike."""
        self.at_s += math.exp(rng.uniform(math.log(low_s), math.log(high_s)))

    def phase(
        self, rng: Rng, entry: Sequence[Stimulus], draw: Draw, quiet_s: float = 0.0, last: Stimulus | None = None
    ) -> None:
        """Add a phase: the inputs that enter a state, a few more, the `last`, quiet; what is taken back then.

        The quiet lasts `quiet_s` mostly, if that is told.
        """
        given = []
        early = draw(rng) if entry and rng.random() < 0.3 else None  # settings are read on entry
        for stimulus in (*((early,) if early else ()), *entry):
            self.give(stimulus)
            self.pause(rng, *PAUSE_S)
        for _ in range(_count(rng)):
            given.append(draw(rng))
            self.give(given[-1])
            self.pause(rng, *PAUSE_S)
        if last is not None:
            self.give(last)
        if quiet_s and rng.random() < QUIET_SHARE:
            self.pause(rng, quiet_s, QUIET_LONGER * quiet_s)
        else:
            self.pause(rng, *self._tempo.settle_s)
        for stimulus in (*((early,) if early else ()), *given):
            self._take_back(rng, stimulus)

    def _take_back(self, rng: Rng, stimulus: Stimulus) -> None:
        rest = self._tempo.rest.get((stimulus.kind, stimulus.name))
        if rest is None or stimulus.values == (rest,) or rng.random() >= RECOVER.get(stimulus.kind, 0.0):
            return
        self.give(msgspec.structs.replace(stimulus, values=(rest,)))

    def stimuli(self) -> Stimuli:
        """Return what was written, in order of time."""
        return tuple(sorted(self._stimuli, key=lambda stimulus: stimulus.at_s))


def _count(rng: Rng) -> int:
    count = 1
    while count < INPUTS_MAX and rng.random() < MORE:
        count += 1
    return count


def cut(stimuli: Stimuli, at_s: float) -> Stimuli:
    """Return the inputs up to a moment."""
    return tuple(stimulus for stimulus in stimuli if stimulus.at_s <= at_s)


def shifted(stimuli: Stimuli, start: int, by_s: float, tempo: Tempo) -> Stimuli:
    """Return the sequence with the inputs from place `start` on given later (or earlier); late ones are dropped."""
    floor_s = stimuli[start - 1].at_s if start else tempo.first_s
    by_s = max(by_s, floor_s - stimuli[start].at_s)
    later = (msgspec.structs.replace(one, at_s=round(one.at_s + by_s, 2)) for one in stimuli[start:])
    return (*stimuli[:start], *(one for one in later if one.at_s <= tempo.last_s))
