"""Bringing the vehicle from where it is likely to be to where a phase begins: the air, or the ground."""

from __future__ import annotations

import msgspec
import numpy as np

from saflite.contract.test_case import Stimulus
from saflite.mutator.exposure.hints import Hint
from saflite.mutator.exposure.phases import Script, Stimuli
from saflite.mutator.exposure.plans import Task
from saflite.mutator.exposure.procedures import GROUND
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.operators.commands import COUNT, LANDS, LIFT, MOVES, place
from saflite.mutator.operators.inputs import Have

Rng = np.random.Generator
COMES_DOWN, MOVED = 0.25, 0.9  # share of landings from which on the vehicle is lifted again, and how often it is
MAY_BE_DOWN = 0.1  # the same where a procedure begins in the air
PAUSE_S = (0.5, 1.5)
LIFT_S, LAND_S = (1.0, 4.0), (20.0, 40.0)
LIFTED_M, CLIMB_MPS = (8.0, 24.0), 2.5  # it takes ten seconds at most, at a speed common to copters
HIGH_M, NEAR_M = 25.0, 40.0  # procedures from so high up are brought there, near home
HEIGHT_M = 20.0  # where a rule names no start


class Bringing:
    """Gives what lifts the vehicle, and what lands it: common to MAVLink, else as earlier flights showed."""

    def __init__(self, have: Have, states: StateModel) -> None:
        """Take the inputs of the target and what is learnt of its states."""
        self._have, self._states = have, states
        given = [key for key in LIFT if key[:2] in have]
        common = [Stimulus(at_s=0.0, kind=kind, name=name, values=values) for kind, name, values in given]
        self._lift = common if len(common) == len(LIFT) else []

    def bring(self, rng: Rng, script: Script, task: Task, mode: str, down: float) -> tuple[str, float]:
        """Write what brings the vehicle there, if it is needed; `down` is how likely it stands on the ground.

        Returns the mode and how likely it stands on the ground then.
        """
        learnt = (one for one in self._states.lift() if one.kind != "mode" or (one.kind, one.name) in self._have)
        way = self._lift or list(learnt)  # some modes only show: nobody can order them
        grounded = task.begins == GROUND
        if self._is_high(task) and down < MAY_BE_DOWN:
            return self._climbed(rng, script, task), down
        enough = COMES_DOWN if task.procedure is None else MAY_BE_DOWN
        if not way or rng.random() >= MOVED or (not grounded and down < enough):
            return mode, down
        if grounded:
            way = way[:-1] if task.armed else [one for one in way[:1] if one.kind == "mode"]
            for stimulus in self._landing() if down < COMES_DOWN else ():
                script.give(stimulus)
                script.pause(rng, *LAND_S)
        height_m = self._height_m(rng, task)
        for stimulus in way:
            lifts = self._lift and stimulus is way[-1] and not grounded
            script.give(_to_height(stimulus, height_m) if lifts else stimulus)
            script.pause(rng, *PAUSE_S)
        if not grounded:
            script.at_s += height_m / CLIMB_MPS
            script.pause(rng, *LIFT_S)
        entered = next((one.name for one in way if one.kind == "mode"), mode)
        return entered, 1.0 if grounded else 0.0

    def _is_high(self, task: Task) -> bool:
        """Whether a procedure needs more height than a vehicle in the air is sure to have."""
        height_m = task.procedure.height_m if task.procedure is not None else None
        return height_m is not None and height_m.low >= HIGH_M and bool(self._lift) and ("command", MOVES) in self._have

    def _climbed(self, rng: Rng, script: Script, task: Task) -> str:
        """Write an order to a place near home at the height of the procedure, in the mode that takes it."""
        height_m = self._height_m(rng, task)
        mode, order = self._lift[0], place(rng, float(rng.uniform(0.0, NEAR_M)), height_m)
        for stimulus in (mode, Stimulus(at_s=0.0, kind="command", name=MOVES, values=order)):
            script.give(stimulus)
            script.pause(rng, *PAUSE_S)
        script.at_s += height_m / CLIMB_MPS
        return mode.name

    def _landing(self) -> Stimuli:
        """Return what brings the vehicle to the ground: the mode known to, else MAVLink's order."""
        known = Stimulus(at_s=0.0, kind="mode", name=self._states.lands())
        common = Stimulus(at_s=0.0, kind="command", name=LANDS, values=(0.0,) * COUNT)
        return tuple(one for one in (known, common) if (one.kind, one.name) in self._have)[:1]

    def _height_m(self, rng: Rng, task: Task) -> float:
        """Return how high to lift the vehicle: as a procedure says, else about where the policy's own flights begin."""
        if task.procedure is not None and task.procedure.height_m is not None:
            return round(task.procedure.height_m.draw(rng), 1)
        height_m: float = usual_height_m(task.hint) * 2.0 ** rng.uniform(-0.5, 0.5)
        return round(min(max(height_m, LIFTED_M[0]), LIFTED_M[1]), 1)


def usual_height_m(hint: Hint) -> float:
    """Return the height at which a policy's own flights begin, where that is in the air."""
    return hint.start.altitude_m if hint.start is not None and hint.start.altitude_m > 0.0 else HEIGHT_M


def _to_height(stimulus: Stimulus, height_m: float) -> Stimulus:
    return msgspec.structs.replace(stimulus, values=(*stimulus.values[:6], height_m))
