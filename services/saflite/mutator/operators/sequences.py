"""Changing timed stimulus sequences: add, replace, retime, drop, join, echo. Pure; the sequence given stays."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import msgspec
import numpy as np

from saflite.contract.test_case import Stimulus

Rng = np.random.Generator
Stimuli = tuple[Stimulus, ...]
Draw = Callable[[Rng], Stimulus]
"""Gives a fresh stimulus; its time does not matter."""


BURST_S = (0.1, 2.0)
NEAR_BURSTS = 0.7  # share of inputs put beside another one that follow (or precede) it as closely as in a burst


class Rhythm(NamedTuple):
    """When stimuli are given: rounds of `round_s`, a share `bursts` of them only 0.1 to 2 s apart.

    A stick is let go at the end of its round in a share `release` of cases, as PGFuzz does after every round: it goes
    back to its value in `rest`, by name; sticks not named there stay.
    """

    start_s: float
    round_s: float
    bursts: float
    release: float
    last_s: float
    steps_max: int
    rest: Mapping[str, float] = MappingProxyType({})


def in_order(stimuli: Sequence[Stimulus]) -> Stimuli:
    """Return the stimuli by time; equal times keep their order."""
    return tuple(sorted(stimuli, key=lambda stimulus: stimulus.at_s))


def moved_to_start(stimuli: Sequence[Stimulus], which: Collection[tuple[str, str]]) -> Stimuli:
    """Return the sequence with the inputs of these kinds and names given at 0 s."""
    return in_order(
        [
            msgspec.structs.replace(one, at_s=0.0) if one.at_s and (one.kind, one.name) in which else one
            for one in stimuli
        ]
    )


def steps(stimuli: Sequence[Stimulus], rhythm: Rhythm) -> int:
    """Return how many stimuli there are, sticks let go not counted."""
    return sum(not _is_release(stimulus, rhythm) for stimulus in stimuli)


def _is_release(stimulus: Stimulus, rhythm: Rhythm) -> bool:
    return stimulus.kind == "stick" and stimulus.values == (rhythm.rest.get(stimulus.name),)


def _pause(rng: Rng, rhythm: Rhythm) -> float:
    """Return a round, or for a burst 0.1 to 2 s with all sizes alike: what matters may last a second, or a tenth."""
    if rng.random() >= rhythm.bursts:
        return rhythm.round_s
    low, high = (math.log(pause_s) for pause_s in BURST_S)
    return math.exp(rng.uniform(low, high))


def _at(stimulus: Stimulus, at_s: float, rhythm: Rhythm) -> Stimulus:
    return msgspec.structs.replace(stimulus, at_s=round(min(max(at_s, 0.0), rhythm.last_s), 2))


def _with_release(rng: Rng, stimulus: Stimulus, rhythm: Rhythm) -> Stimuli:
    if stimulus.kind != "stick" or stimulus.name not in rhythm.rest or _is_release(stimulus, rhythm):
        return (stimulus,)
    if rng.random() >= rhythm.release:
        return (stimulus,)
    let_go = msgspec.structs.replace(stimulus, values=(rhythm.rest[stimulus.name],))
    return stimulus, _at(let_go, stimulus.at_s + rhythm.round_s, rhythm)


def fresh(rng: Rng, draw: Draw, count: int, rhythm: Rhythm) -> Stimuli:
    """Return a new sequence of `count` stimuli."""
    made: list[Stimulus] = []
    at_s = rhythm.start_s
    for _ in range(count):
        made.extend(_with_release(rng, _at(draw(rng), at_s, rhythm), rhythm))
        at_s += _pause(rng, rhythm)
    return in_order(made)


def add(rng: Rng, parent: Stimuli, draw: Draw, rhythm: Rhythm) -> Stimuli:
    """Return the sequence with one more stimulus: after the last, or soon after or before another.

    Before, because what came close may lack nothing but the state it has to be given in.
    """
    last_s = max((stimulus.at_s for stimulus in parent), default=rhythm.start_s - rhythm.round_s)
    at_s = last_s + _pause(rng, rhythm)
    if parent and rng.random() < 0.6:
        near_s = parent[int(rng.integers(len(parent)))].at_s
        pause_s = _pause(rng, rhythm._replace(bursts=max(rhythm.bursts, NEAR_BURSTS)))
        at_s = near_s + (pause_s if rng.random() < 0.4 else -pause_s)
    return in_order([*parent, *_with_release(rng, _at(draw(rng), at_s, rhythm), rhythm)])


def replace(rng: Rng, parent: Stimuli, draw: Draw, rhythm: Rhythm) -> Stimuli:
    """Return the sequence with one stimulus exchanged for a fresh one at the same time."""
    index = int(rng.integers(len(parent)))
    made = _with_release(rng, _at(draw(rng), parent[index].at_s, rhythm), rhythm)
    return in_order([*parent[:index], *made, *parent[index + 1 :]])


def retime(rng: Rng, parent: Stimuli, rhythm: Rhythm) -> Stimuli:
    """Return the sequence with one stimulus given earlier or later by up to a round."""
    index = int(rng.integers(len(parent)))
    at_s = parent[index].at_s + float(rng.uniform(-rhythm.round_s, rhythm.round_s))
    return in_order([*parent[:index], _at(parent[index], at_s, rhythm), *parent[index + 1 :]])


def drop(rng: Rng, parent: Stimuli) -> Stimuli:
    """Return the sequence without one of its stimuli."""
    index = int(rng.integers(len(parent)))
    return (*parent[:index], *parent[index + 1 :])


def echo(rng: Rng, parent: Stimuli) -> Stimuli:
    """Return the sequence with one parameter set to the value of another, unchanged if there are not two.

    Two settings that are equal is what differences in a denominator do not survive.
    """
    places = [place for place, stimulus in enumerate(parent) if stimulus.kind == "parameter"]
    if len({parent[place].name for place in places}) < 2:
        return parent
    place, other = (places[index] for index in rng.choice(len(places), size=2, replace=False))
    changed = msgspec.structs.replace(parent[place], values=parent[other].values)
    return (*parent[:place], changed, *parent[place + 1 :])


def join(rng: Rng, first: Stimuli, second: Stimuli, rhythm: Rhythm) -> Stimuli:
    """Return the beginning of one sequence with the end of another, cut at one moment."""
    cut_s = float(rng.uniform(rhythm.start_s, rhythm.last_s))
    head = [stimulus for stimulus in first if stimulus.at_s <= cut_s]
    tail = [stimulus for stimulus in second if stimulus.at_s > cut_s]
    joined = in_order([*head, *tail])
    return joined if joined and steps(joined, rhythm) <= rhythm.steps_max else first
