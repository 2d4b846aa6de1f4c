"""Sequences of inputs in phases: into a state, a few inputs close together, then quiet, for rules that wait for it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
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
BARE, BARE_ORDER = 0.15, 0.4  # share of phases, and of those with an order, without any other input
MORE = 0.6  # chance of one more input in a phase
INPUTS_MAX = 6
QUIET_SHARE, QUIET_LONGER = 0.75, 1.5  # how often a phase lasts as long as the rule asks for, how much longer at most
MUCH_LONGER_SHARE, MUCH_LONGER = 0.2, 3.0  # where the vehicle has to come to first: over home, to the ground
SET_PAUSE_S = (0.05, 0.3)  # between settings given first of all
LEAD_PAUSE_S = (0.5, 4.0)  # between inputs that bring the vehicle to where a phase begins
ACT_S = (2.0, 12.0)  # for what moves the vehicle before a phase's state is entered
EARLY = 0.5  # share of phases with inputs before the state is entered, and share of those inputs
LET_GO = 0.5  # share of phases in which the sticks are let go before the quiet
RECOVER: dict[StimulusKind, float] = {"stick": 0.98, "sensor_fault": 0.98, "parameter": 0.9}
"""Chance that an input is taken back at the end of its phase: sticks let go, faults mended, settings reset."""


class Tempo(NamedTuple):
    """When inputs may be given: from `first_s` to `last_s`; a phase ends with `settle_s` of quiet; values at rest."""

    first_s: float
    last_s: float
    settle_s: tuple[float, float]
    rest: Mapping[tuple[StimulusKind, str], float]


class Phase(NamedTuple):
    """What a phase is made of.

    `pushed` are settings given first of all, `lead` brings the vehicle to where the phase begins, `act` is given there
    and has its time (and `act_s` more), `entry` enters the state, `first` are inputs it must have before those that
    `draw` gives, `held` sticks stay through the quiet, which is `quiet_s` long mostly if that is told; each of `last`
    is given right before such a quiet.
    """

    draw: Draw
    entry: tuple[Stimulus, ...] = ()
    pushed: tuple[Stimulus, ...] = ()
    lead: tuple[Stimulus, ...] = ()
    act: tuple[Stimulus, ...] = ()
    act_s: float = 0.0
    first: tuple[Stimulus, ...] = ()
    held: tuple[Stimulus, ...] = ()
    quiet_s: float = 0.0
    last: tuple[Stimulus, ...] = ()


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

    def phase(self, rng: Rng, phase: Phase) -> None:
        """Add a phase: into a state, a few inputs, quiet; what is taken back then."""
        for stimulus in phase.pushed:
            self.give(stimulus)
            self.pause(rng, *SET_PAUSE_S)
        for stimulus in phase.lead:
            self.give(stimulus)
            self.pause(rng, *LEAD_PAUSE_S)
        for stimulus in phase.act:
            self.give(stimulus)
            self.at_s += phase.act_s
            self.pause(rng, *ACT_S)
        bare = rng.random() < (BARE_ORDER if phase.last else BARE)
        many = 0 if bare else _count(rng) - len(phase.first)
        given = [*phase.first, *(phase.draw(rng) for _ in range(many))]
        early: list[Stimulus] = []
        if phase.entry and rng.random() < EARLY:  # settings are read on entry, faults matter to it
            early = [one for one in given if rng.random() < EARLY and one.kind != "mode"]
        for stimulus in (*early, *phase.entry, *(one for one in given if one not in early), *phase.held):
            self.give(stimulus)
            self.pause(rng, *PAUSE_S)
        let_go = not phase.held and rng.random() < LET_GO
        for last in phase.last or (None,):
            if last is not None:
                self.give(last)
            if let_go:
                self._let_go(rng, (*phase.act, *given), ("stick",))
            self._quiet(rng, phase.quiet_s)
        self._let_go(rng, (*phase.pushed, *phase.act, *given, *phase.held), tuple(RECOVER))

    def _quiet(self, rng: Rng, quiet_s: float) -> None:
        if quiet_s and rng.random() < QUIET_SHARE:
            longer = MUCH_LONGER if rng.random() < MUCH_LONGER_SHARE else QUIET_LONGER
            self.pause(rng, quiet_s, longer * quiet_s)
        else:
            self.pause(rng, *self._tempo.settle_s)

    def again(
        self, rng: Rng, lead: Sequence[Stimulus], steps: Sequence[tuple[float, Stimulus]], lasts_s: float
    ) -> None:
        """Add inputs at their times from now on, after the `lead`; then quiet, and what is taken back."""
        for stimulus in lead:
            self.give(stimulus)
            self.pause(rng, *LEAD_PAUSE_S)
        begin_s = self.at_s
        for after_s, stimulus in steps:
            self.at_s = begin_s + after_s
            self.give(stimulus)
        self.at_s = begin_s + lasts_s
        self.pause(rng, *self._tempo.settle_s)
        self._let_go(rng, [stimulus for _, stimulus in steps], tuple(RECOVER))

    def follow(self, rng: Rng, steps: Iterable[tuple[Stimulus | None, float]]) -> None:
        """Give inputs, each with the time that goes by after it (None: the sticks are let go); take them back."""
        given: list[Stimulus] = []
        for stimulus, after_s in steps:
            if stimulus is None:
                self._let_go(rng, given, ("stick",))
            else:
                self.give(stimulus)
                given.append(stimulus)
            self.at_s += after_s
        self._let_go(rng, given, tuple(RECOVER), surely=True)

    def _let_go(
        self, rng: Rng, given: Sequence[Stimulus], kinds: Sequence[StimulusKind], *, surely: bool = False
    ) -> None:
        """Take inputs back, each once; one that is at rest already stays."""
        last = {(one.kind, one.name): one for one in self._stimuli}
        for key in dict.fromkeys((one.kind, one.name) for one in given):
            rest = self._tempo.rest.get(key)
            if key[0] not in kinds or rest is None or key not in last or last[key].values == (rest,):
                continue
            if surely or rng.random() < RECOVER.get(key[0], 0.0):
                self.give(msgspec.structs.replace(last[key], values=(rest,)))

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
