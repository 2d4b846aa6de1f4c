"""What the phases of a flight are for, and in which order they come."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from saflite.mutator.exposure.hints import Hint
from saflite.mutator.exposure.procedures import AIR, GROUND, Procedure
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.exposure.survival import Survival
from saflite.mutator.exposure.tried import Tried, Variant

Rng = np.random.Generator
ENDING = 2.0  # how much more it counts that nothing flew after a policy's phase than that the vehicle came down
GROUND_ORDERS, GROUND_LIFTS = 0.2, 0.5  # how much later an order on the ground comes, and what lifts the vehicle


class Task(NamedTuple):
    """A phase to be written: for which policy, and by which procedure of its own (None: drawn freely).

    `begun` is a procedure of another policy that is under way as its own begins (None: none is).
    """

    hint: Hint
    procedure: Procedure | None = None
    begun: Procedure | None = None

    @property
    def begins(self) -> str:
        """Where it begins: a mission, the ground, or the air."""
        return (self.procedure or self.hint).begins

    @property
    def armed(self) -> bool:
        """Whether the motors are on where it begins on the ground."""
        return self.procedure is None and (self.hint.start is None or self.hint.start.armed)


class Planner:
    """Decides which phases follow a procedure and which come last, from what earlier flights showed."""

    def __init__(
        self,
        states: StateModel,
        survival: Survival,
        tried: Tried,
        followed: float,
        crossed: float,
        lent: float = 0.0,
    ) -> None:
        """Take what is learnt and three shares.

        `followed` of the phases follow a procedure where there are some; `crossed` of those in the air begin while
        another one is under way. Before that `lent` of all follow one of a rule that the campaign is not about.
        """
        self._states, self._survival, self._tried = states, survival, tried
        self._followed, self._crossed, self._lent = followed, crossed, lent
        self._procedures: Mapping[str, Sequence[Procedure]] = {}
        self._others: Sequence[Sequence[Procedure]] = ()
        self._begun: Sequence[Sequence[Procedure]] = ()

    def tell_of(
        self,
        hints: Sequence[Hint],
        procedures: Mapping[str, Sequence[Procedure]],
        others: Sequence[Sequence[Procedure]] = (),
    ) -> None:
        """Take the procedures of all policies, which failsafes these are about, and those of each other rule."""
        self._procedures, self._others = procedures, [found for found in others if found]
        about: dict[str, list[Procedure]] = {}
        for hint in hints:
            kept = [one for one in procedures.get(hint.policy, ()) if one.begins == AIR and not one.last]
            for word in hint.raised or ("",):
                about.setdefault(word, []).extend(kept)
        for found in self._others:
            about.setdefault("", []).extend(one for one in found if one.begins == AIR and not one.last)
        self._begun = [kept for _, kept in sorted(about.items()) if kept]

    def in_turn(self, rng: Rng, hints: Sequence[Hint]) -> list[Task]:
        """Return a task for each policy in the order of their phases: on the ground first, what ends there late.

        After some nothing flies any more (a parachute, a fall): these are the last. Among those that begin on the
        ground the ones come last that lift the vehicle, or give an order, which does mostly.
        """
        tasks = [self.task(rng, hint) for hint in hints]
        return sorted(tasks, key=lambda task: self._late(task) + float(rng.uniform(0.0, 0.5)))

    def task(self, rng: Rng, hint: Hint) -> Task:
        """Return a task for a policy: by one of its procedures, by one of another rule, or drawn freely."""
        if self._others and not hint.flies_mission and rng.random() < self._lent:
            found = self._others[int(rng.integers(len(self._others)))]
            return Task(hint, found[int(rng.integers(len(found)))])
        known = self._procedures.get(hint.policy, ())
        if not known or rng.random() >= self._followed:
            return Task(hint)
        number = self._tried.least(rng, hint.policy, [one.number for one in known])
        own = next(one for one in known if one.number == number)
        if own.begins != AIR or rng.random() >= self._crossed:
            return Task(hint, own)
        return Task(hint, own, self.any(rng, own.policy))

    def variant(self, rng: Rng, task: Task) -> Variant | None:
        """Return what chooses the options of a task's procedure; None for one drawn freely, crossed, or lent."""
        procedure = task.procedure
        if procedure is None or task.begun is not None or procedure.policy != task.hint.policy:
            return None
        return Variant(self._tried, rng, procedure)

    def any(self, rng: Rng, but: str = "") -> Procedure | None:
        """Return one in the air of any policy `but` one: each failsafe, and none, alike, however many are about it."""
        others = [kept for about in self._begun if (kept := [one for one in about if one.policy != but])]
        if not others:
            return None
        about = others[int(rng.integers(len(others)))]
        return about[int(rng.integers(len(about)))]

    def down(self, task: Task, mode: str, before: float) -> float:
        """Return how likely the vehicle stands on the ground after a task, and how likely it did `before`."""
        stood = 0.0 if task.procedure is not None and task.procedure.lifts else before
        sunk = self._states.comes_down((mode, *task.hint.raised))
        return 1.0 - (1.0 - stood) * (1.0 - max(sunk, self._survival.comes_down(task.hint.policy)))

    def _late(self, task: Task) -> float:
        hint, procedure = task.hint, task.procedure
        if task.begins == GROUND:
            lifts = procedure is not None and procedure.lifts
            return GROUND_ORDERS * bool(hint.orders()) + GROUND_LIFTS * lifts - 1.0
        down = max(self._states.comes_down(hint.raised), self._survival.comes_down(hint.policy))
        last = any(one.last for one in self._procedures.get(hint.policy, ()))
        ends = 1.0 if last else self._survival.ends(hint.policy)
        return max(down, ENDING * ends) - 2.0 * hint.flies_mission
