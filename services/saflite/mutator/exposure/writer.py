"""Writing fresh sequences: a phase for each policy in turn, from where its flights begin into the state it is about."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from saflite.contract.test_case import StartState, Stimulus
from saflite.mutator.exposure.drawing import Drawing, Style
from saflite.mutator.exposure.hints import Hint
from saflite.mutator.exposure.phases import Phase, Script, Stimuli, Tempo
from saflite.mutator.exposure.probes import Probes, beyond
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.exposure.vocabulary import pick
from saflite.mutator.operators.inputs import Have
from saflite.mutator.operators.values import LIFT

Rng = np.random.Generator
ASKED = 0.6  # chance that a setting has the value a rule asks for
ORDERED = 0.7  # share of phases that end with a command their rule is about: it waits for what follows, undisturbed
CAUSED = 0.7  # share of phases, for rules about a raised failsafe, that begin with what may raise it
KNOWN = 0.7  # share of those that begin with what raised it before, where something did
ACTS = 0.5  # share of phases, from one mode into another, before which something moves the vehicle
FROM_START = 0.6  # share of phases that come from the mode in which the rule's own flights begin
HELD = 0.7  # share of phases in which a stick stays where a rule asks for it
COMES_DOWN, MOVED = 0.2, 0.8  # share of landings from which on the vehicle is lifted again, and how often it is
DEADLY = 6.0
LIFT_S, LAND_S = (5.0, 10.0), (10.0, 30.0)
LAX = 0.6  # share of test cases that set what is known to take any value


class Writer:
    """Writes with what is drawn, known of the target's states, and of the ranges it checks."""

    def __init__(self, have: Have, drawing: Drawing, states: StateModel, probes: Probes) -> None:
        self._have, self._drawing, self._states, self._probes = have, drawing, states, probes
        given = [key for key in LIFT if key[:2] in have]
        common = [Stimulus(at_s=0.0, kind=kind, name=name, values=values) for kind, name, values in given]
        self._lift = common if len(common) == len(LIFT) else []

    def fresh(self, rng: Rng, tempo: Tempo, start: StartState | None, hints: Sequence[Hint], many: int) -> Stimuli:
        """Return up to `many` phases, the policies in turn, for a flight with this start (None: a mission)."""
        script, mode = Script(tempo), start.mode if start is not None else ""
        down = 1.0 if start is not None and start.altitude_m <= 0.0 else 0.0
        styles = [self._drawing.style(rng, hint) for hint in self._in_turn(rng, hints)]
        for stimulus in (*self._asked(rng, hints), *self._probed(rng)):
            script.give(stimulus)
        for number in range(many):
            style = styles[number % len(styles)]
            if number:
                mode, down = self._moved(rng, script, style.hint, mode, down)
            mode = self.phase(rng, script, style, mode)
            down = max(down, self._states.comes_down((mode, *style.hint.raised)))
            if script.is_full:
                break
        return script.stimuli()

    def _in_turn(self, rng: Rng, hints: Sequence[Hint]) -> list[Hint]:
        """Return the policies in the order of their phases: those whose states end on the ground mostly last.

        Among those that begin there the ones about an order, which lifts the vehicle mostly, come last.
        """

        def late(hint: Hint) -> float:
            down = self._states.comes_down((*hint.modes[:1], *hint.raised))
            return (0.5 * bool(hint.orders()) if hint.begins == "ground" else down) - hint.flies_mission

        return sorted(hints, key=lambda hint: late(hint) + float(rng.uniform(0.0, 0.5)))

    def _moved(self, rng: Rng, script: Script, hint: Hint, mode: str, down: float) -> tuple[str, float]:
        """Bring the vehicle from where it is likely to be to where a policy's flights begin: the air, or the ground.

        Returns the mode and how likely it stands on the ground then.
        """
        way = self._lift or self._states.lift()
        grounded = hint.begins == "ground"
        if not way or rng.random() >= MOVED or (not grounded and down < COMES_DOWN):
            return mode, down
        if grounded:
            way = way[:-1]
            if down < COMES_DOWN and (lands := self._states.lands()):
                script.give(self._mode(lands)[0])
                script.pause(rng, *LAND_S)
        for stimulus in way:
            script.give(stimulus)
            script.pause(rng, 0.5, 1.5)
        if not grounded:
            script.pause(rng, *LIFT_S)
        return way[0].name, 1.0 if grounded else 0.0

    def phase(self, rng: Rng, script: Script, style: Style, mode: str) -> str:
        """Write a phase; return the mode it is meant to be flown in."""
        hint = style.hint
        lead: tuple[Stimulus, ...] = ()
        start_mode = hint.start.mode if hint.start is not None and hint.start.altitude_m > 0.0 else mode
        if start_mode != mode and rng.random() < FROM_START:
            lead, mode = self._mode(start_mode), start_mode
        entry = self._entry(rng, hint, mode)
        first = self._cause(rng, style) if hint.raised and rng.random() < CAUSED else ()
        phase = Phase(
            draw=partial(self._drawing.draw, style),
            entry=entry,
            lead=lead,
            act=self._act(rng, hint) if entry and mode == start_mode else (),
            first=first,
            held=self._held(rng, hint),
            quiet_s=hint.quiet_s,
            last=self._order(rng, hint),
        )
        script.phase(rng, phase)
        return entry[0].name if entry else mode

    def _act(self, rng: Rng, hint: Hint) -> tuple[Stimulus, ...]:
        """Return a command or stick of the rule's own that moves the vehicle in the mode where its flights begin."""
        movers = [entry for entry in hint.inputs if entry.kind in ("command", "stick")]
        if not movers or rng.random() >= ACTS:
            return ()
        return (self._drawing.given(rng, movers[int(rng.integers(len(movers)))]),)

    def _mode(self, name: str) -> tuple[Stimulus, ...]:
        return (Stimulus(at_s=0.0, kind="mode", name=name),) if ("mode", name) in self._have else ()

    def _held(self, rng: Rng, hint: Hint) -> tuple[Stimulus, ...]:
        """Return a stick where the formula asks for it, mostly, if it asks for any."""
        if not hint.held or rng.random() >= HELD:
            return ()
        entry, value = hint.held[int(rng.integers(len(hint.held)))]
        return (Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=(value,)),)

    def _cause(self, rng: Rng, style: Style) -> tuple[Stimulus, ...]:
        """Return what raised a failsafe of the rule before; where nothing is known a fault or setting of its own."""
        known = self._states.cause(rng, style.hint.raised)
        if known is not None and rng.random() < KNOWN:
            return (known,)
        faults = [entry for entry in style.hint.inputs if entry.kind == "sensor_fault"]
        entries = faults or [entry for entry in style.hint.inputs if entry.kind in ("parameter", "stick")]
        return (self._drawing.given(rng, entries[int(rng.integers(len(entries)))]),) if entries else ()

    def _probed(self, rng: Rng) -> list[Stimulus]:
        """Return settings outside their range: some that are to be asked, and those known to take any value."""
        asked = [self._probes.draw(rng) for _ in range(self._probes.at_once)]
        values = [*((entry, beyond(rng, entry)) for entry in asked), *self._probes.lax_values(rng, LAX)]
        return [Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=(value,)) for entry, value in values]

    def _order(self, rng: Rng, hint: Hint) -> Stimulus | None:
        """Return a command the rule is about, to be followed by nothing but quiet; often none."""
        orders = hint.orders()
        return (
            self._drawing.given(rng, orders[int(rng.integers(len(orders)))])
            if orders and rng.random() < ORDERED
            else None
        )

    def _asked(self, rng: Rng, hints: Iterable[Hint]) -> list[Stimulus]:
        """Return settings with values that the formulas of the policies ask for, one of each."""
        asked: dict[str, Stimulus] = {}
        pairs = [pair for hint in hints for pair in hint.asked]
        for place in rng.permutation(len(pairs)):
            entry, value = pairs[place]
            if entry.name not in asked and rng.random() < ASKED:
                asked[entry.name] = Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=(value,))
        return list(asked.values())

    def _entry(self, rng: Rng, hint: Hint, mode: str) -> tuple[Stimulus, ...]:
        """Return what enters a state a policy is about: a mode its formula names, of its inputs, seldom any.

        Modes in which most flights crash are entered less: nothing comes after them.
        """
        way, about = rng.random(), list(hint.modes)
        own = [entry.name for entry in hint.inputs if entry.kind == "mode"]
        every = [name for kind, name in self._have if kind == "mode"]
        names = (about or own or every) if way < 0.7 else (own or about or every) if way < 0.9 else every
        if not names or (mode in names and rng.random() < 0.5):
            return ()
        sound = [1.0 / (1.0 + DEADLY * self._states.crashes(name)) for name in names]
        name = pick(rng, names, sound)
        return () if name == mode else (Stimulus(at_s=0.0, kind="mode", name=name),)
