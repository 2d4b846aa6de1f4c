"""Writing fresh sequences: a phase for each policy in turn, from where its flights begin into the state it is about."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from saflite.contract.test_case import StartState, Stimulus
from saflite.mutator.exposure.attention import Span
from saflite.mutator.exposure.bringing import Bringing, usual_height_m
from saflite.mutator.exposure.drawing import Drawing, Style
from saflite.mutator.exposure.hints import Hint
from saflite.mutator.exposure.phases import PAUSE_S, SET_PAUSE_S, Phase, Script, Stimuli, Tempo
from saflite.mutator.exposure.plans import Planner, Task
from saflite.mutator.exposure.probes import Probes, beyond
from saflite.mutator.exposure.procedures import AIR, GROUND, Move, broken_off, moves, without_entry
from saflite.mutator.exposure.recipes import Recipe, Recipes
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import pick
from saflite.mutator.operators.commands import MOVES, away
from saflite.mutator.operators.inputs import Have

Rng = np.random.Generator
ASKED = 0.6  # chance that a setting has the value a rule asks for
ORDERED, ONE_MORE = 0.85, 0.4  # share of phases that end with a command their rule is about, and of those with two
CAUSED = 0.85  # share of phases, for rules about a raised failsafe, that begin with what may raise it
KNOWN = 0.8  # share of those that begin with what raised it before, where something did
ACTS = 0.5  # share of phases, from one mode into another, before which something moves the vehicle
FROM_START = 0.6  # share of phases that come from the mode in which the rule's own flights begin
HELD = 0.8  # share of phases in which a stick stays where a rule asks for it
UPSET = 0.5  # share of phases, for rules about a lost sensor, in which a fault of their own comes first
MOVED_OFF = 0.4  # chance of each setting that the rule reads to be off its default from the start
INTERRUPTED, DISTURBED = 0.5, 0.25  # share of flights left to themselves that get procedures, or one input, on the way
INTERRUPTIONS_MAX = 4  # procedures in a mission
RESUMED_S = (2.0, 12.0)  # time after one until the mission is gone on with
MISSION_MODE = "AUTO"
DEFLECTED = 0.2  # the same for rules that ask for no stick but have some
PUSHED = 0.7  # chance that a setting is moved the way in which a comparison with it becomes true
AWAY = 0.85  # share of phases, for rules that want the vehicle away from home, in which it is sent there
AWAY_S = (2.0, 20.0)  # it is given to come there, besides
KIN = 0.5  # share of recipes, for a rule about a failsafe, that are of another rule about it
SET_BEFORE, DISTURBS = 0.3, 0.35  # share of procedures after a setting of the rule's; chance of one more input in it
ENTERED = 0.5  # share of procedures, begun while another is under way, that enter their own mode first
SELDOM, SELDOM_S = 0.3, (2.0, 8.0)  # share of procedures with an input seldom given in the mode at hand, time after it
DEADLY = 6.0
ABOUT, OWN_MODE = 0.85, 0.95  # share of phases entered by a mode the formula names; by one of these or of its inputs
STAYS = 0.3  # share of phases without an order of a mode that is thought to be flown; it may have ended by itself
REFUSED = 0.35  # share of times taken, below which an input is rather given in another mode
REDRAWN, STRETCHED, ADDED = 0.25, 0.5, 0.5  # of its inputs; of its times; chance of one more input
ADDED_MAX = 3
STRETCH = (0.7, 1.6)
LAX = 0.6  # share of test cases that set what is known to take any value


class Memory(NamedTuple):
    """What earlier flights taught a writer."""

    states: StateModel
    recipes: Recipes
    taken: Taken
    plans: Planner


class Writer:
    """Writes with what is drawn, known of the target's states, and of the ranges it checks."""

    def __init__(self, have: Have, drawing: Drawing, probes: Probes, memory: Memory, recalled: float) -> None:
        """Take what is drawn from; `recalled` is the share of free phases that give a recipe where one is known."""
        self._have, self._drawing, self._probes, self._recalled = have, drawing, probes, recalled
        self._states, self._recipes, self._taken, self._plans = memory
        self._bringing = Bringing(have, memory.states)
        self._kin: dict[str, tuple[str, ...]] = {}

    def tell_of(self, hints: Sequence[Hint]) -> None:
        """Take what is known of all policies: which are about the same failsafes."""
        for hint in hints:
            words = set(hint.raised)
            kin = [one.policy for one in hints if one.policy != hint.policy and words.intersection(one.raised)]
            self._kin[hint.policy] = tuple(kin)

    def fresh(
        self, rng: Rng, tempo: Tempo, start: StartState | None, tasks: Sequence[Task], many: int
    ) -> tuple[Stimuli, tuple[Span, ...]]:
        """Return up to `many` phases, the tasks in turn, for a flight with this start (None: a mission).

        Also returns when whose phase begins.
        """
        spans: list[Span] = []
        script, mode = Script(tempo), start.mode if start is not None else ""
        down = 1.0 if start is not None and start.altitude_m <= 0.0 else 0.0
        styles = [self._drawing.style(rng, task.hint) for task in tasks]
        for stimulus in (*self._asked(rng, [task.hint for task in tasks if not task.procedure]), *self._probed(rng)):
            script.give(stimulus)
        for number in range(many):
            style, from_s = styles[number % len(styles)], script.at_s
            task = tasks[number] if number < len(tasks) else self._plans.task(rng, style.hint)
            if number or (task.procedure is not None and task.begins != (GROUND if down else AIR)):
                mode, down = self._bringing.bring(rng, script, task, mode, down)
            if script.is_full:
                break
            variant = self._plans.variant(rng, task)
            if task.procedure is None:
                mode = self.phase(rng, script, style, mode)
            else:
                steps = moves(rng, task.procedure, self._drawing, variant)
                mode = self._follow(rng, script, style, task, steps, mode)
            spans.append(Span(style.hint.policy, from_s, variant.text if variant else ""))
            down = self._plans.down(task, mode, down)
        return script.stimuli(), tuple(spans)

    def calm(self, rng: Rng, tempo: Tempo, hints: Sequence[Hint]) -> Stimuli:
        """Return a flight left to itself: settings before it, then no input, a single one of a policy's own, or a few
        procedures of any policies, begun in the middle, after each of which the mission is gone on with.
        """
        script = Script(tempo)
        for hint in hints:
            for stimulus in (*self._asked(rng, [hint]), *self._pushed(rng, hint)):
                script.give(stimulus)
                script.pause(rng, *SET_PAUSE_S)
        way, begins_s, ends_s = rng.random(), script.at_s, max(script.at_s, tempo.last_s)
        if way < INTERRUPTED:
            many = 1 + int(rng.integers(INTERRUPTIONS_MAX))
            times_s = np.sort(rng.uniform(begins_s, ends_s, size=many))
            for at_s in times_s.tolist():
                script.at_s = max(script.at_s, at_s)
                self._interrupt(rng, script)
        elif way < INTERRUPTED + DISTURBED:
            script.at_s = float(rng.uniform(begins_s, ends_s))
            hint = hints[int(rng.integers(len(hints)))]
            (order, *_) = (*self._orders(rng, hint), None)
            script.give(order or self._drawing.draw(self._drawing.style(rng, hint), rng))
        return script.stimuli()

    def _interrupt(self, rng: Rng, script: Script) -> None:
        """Write a procedure of any policy without the mode it begins in, then the mode in which missions are flown."""
        procedure = self._plans.any(rng)
        if procedure is None:
            return
        script.follow(rng, without_entry(moves(rng, procedure, self._drawing)))
        script.pause(rng, *RESUMED_S)
        for stimulus in self._mode(MISSION_MODE):
            script.give(stimulus)

    def _follow(self, rng: Rng, script: Script, style: Style, task: Task, steps: list[Move], mode: str) -> str:
        """Write steps as a phase, with a setting of the rule's moved or a few inputs more; return its mode."""
        own = [entry for entry in (*style.hint.read, *style.hint.inputs) if entry.kind == "parameter"]
        if task.begun is not None:
            steps = steps if rng.random() < ENTERED else without_entry(steps)
            steps = [*broken_off(rng, moves(rng, task.begun, self._drawing)), *steps]
        if own and rng.random() < SET_BEFORE:
            steps.insert(0, Move(self._drawing.moved(rng, own[int(rng.integers(len(own)))]), SET_PAUSE_S[0]))
        entered = [one.stimulus.name for one in steps if one.stimulus is not None and one.stimulus.kind == "mode"]
        style = style._replace(mode=entered[-1] if entered else mode)
        for _ in range(ADDED_MAX):
            if rng.random() >= DISTURBS:
                break
            steps.insert(int(rng.integers(len(steps) + 1)), Move(self._drawing.draw(style, rng), PAUSE_S[0]))
        if rng.random() < SELDOM:
            steps = self._with_seldom(rng, steps, mode)
        script.follow(rng, steps)
        script.pause(rng, *SET_PAUSE_S)
        entered = [one.stimulus.name for one in steps if one.stimulus is not None and one.stimulus.kind == "mode"]
        return entered[-1] if entered else mode

    def _with_seldom(self, rng: Rng, steps: Sequence[Move], mode: str) -> list[Move]:
        """Return the steps with an input among them that was given seldom in the mode there, and quiet after it."""
        place = int(rng.integers(len(steps) + 1))
        before = [
            one.stimulus.name for one in steps[:place] if one.stimulus is not None and one.stimulus.kind == "mode"
        ]
        stimulus = self._drawing.seldom(rng, before[-1] if before else mode)
        more = [Move(stimulus, float(rng.uniform(*SELDOM_S)))] if stimulus is not None else []
        return [*steps[:place], *more, *steps[place:]]

    def phase(self, rng: Rng, script: Script, style: Style, mode: str) -> str:
        """Write a phase; return the mode it is meant to be flown in."""
        hint = style.hint
        recipe = self._recalled_for(rng, hint) if rng.random() < self._recalled else None
        if recipe is not None:
            return self._again(rng, script, style, recipe, mode)
        lead: tuple[Stimulus, ...] = ()
        start_mode = hint.start.mode if hint.start is not None and hint.start.altitude_m > 0.0 else mode
        far = self._away(rng, hint)
        if start_mode != mode and (far or rng.random() < FROM_START):
            lead, mode = self._mode(start_mode), start_mode
        entry = self._entry(rng, hint, mode)
        lead = self._taken_from(entry, mode) or lead
        last = self._orders(rng, hint)
        entry = self._taken_from(last, entry[0].name if entry else mode) or entry
        style = style._replace(mode=entry[0].name if entry else mode)
        caused = (CAUSED if hint.raised else 0.0, UPSET if hint.upset else 0.0)
        first = self._cause(rng, style) if rng.random() < max(caused) else ()
        phase = Phase(
            draw=partial(self._drawing.draw, style),
            entry=entry,
            pushed=self._pushed(rng, hint),
            lead=lead,
            act=far or (self._act(rng, hint) if entry and mode == start_mode else ()),
            act_s=float(rng.uniform(*AWAY_S)) if far else 0.0,
            first=first,
            held=self._held(rng, hint),
            quiet_s=hint.quiet_s,
            last=last,
        )
        script.phase(rng, phase)
        return entry[0].name if entry else mode

    def _taken_from(self, given: tuple[Stimulus, ...], mode: str) -> tuple[Stimulus, ...]:
        """Return what enters a mode in which an input is taken, where it mostly is not in the one at hand."""
        for one in given:
            key = (one.kind, one.name)
            better = self._taken.best(key) if mode and self._taken.share(key, mode) < REFUSED else ""
            if better and self._taken.share(key, better) >= REFUSED:
                return self._mode(better)
        return ()

    def _recalled_for(self, rng: Rng, hint: Hint) -> Recipe | None:
        """Return what made a rule apply; for one about a raised failsafe also what raised it for another rule."""
        kin = self._kin.get(hint.policy, ())
        if kin and rng.random() < KIN:
            other = self._recipes.draw(rng, kin[int(rng.integers(len(kin)))])
            if other is not None:
                return other
        return self._recipes.draw(rng, hint.policy)

    def _again(self, rng: Rng, script: Script, style: Style, recipe: Recipe, mode: str) -> str:
        """Write a phase that made the rule apply before, with other values, times and a few inputs more."""
        low, high = (math.log(share) for share in STRETCH)
        stretch = math.exp(rng.uniform(low, high)) if rng.random() < STRETCHED else 1.0
        first_s, lasts_s = recipe.stimuli[0].at_s, stretch * recipe.lasted_s
        steps = [(stretch * (one.at_s - first_s), self._varied(rng, style.hint, one)) for one in recipe.stimuli]
        for _ in range(ADDED_MAX):
            if rng.random() >= ADDED:
                break
            steps.append((float(rng.uniform(0.0, lasts_s)), self._drawing.draw(style, rng)))
        steps.sort(key=lambda step: step[0])
        script.again(rng, self._mode(recipe.mode) if recipe.mode != mode else (), steps, lasts_s)
        return next((one.name for _, one in reversed(steps) if one.kind == "mode"), recipe.mode)

    def _varied(self, rng: Rng, hint: Hint, stimulus: Stimulus) -> Stimulus:
        """Return an input again, now and then with other values, or another mode that the rule is about."""
        entry = self._have.get((stimulus.kind, stimulus.name))
        if entry is None or rng.random() >= REDRAWN:
            return stimulus
        if stimulus.kind == "mode":
            others = hint.modes if stimulus.name in hint.modes else (stimulus.name,)
            return msgspec.structs.replace(stimulus, name=pick(rng, others, [self._worth(hint, one) for one in others]))
        return self._drawing.given(rng, entry)

    def _worth(self, hint: Hint, mode: str) -> float:
        """Return what a mode is worth entering: less where flights crash, and where the rule has applied before."""
        return self._recipes.seldom(hint.policy, mode) / (1.0 + DEADLY * self._states.crashes(mode))

    def _pushed(self, rng: Rng, hint: Hint) -> tuple[Stimulus, ...]:
        """Return settings moved the way in which what the rule compares with them comes true, and one that it reads."""
        asked = {entry.name for entry, _ in hint.asked}
        free = [(entry, sense) for entry, sense in hint.pushed if entry.name not in asked]
        chosen = [(entry, sense) for entry, sense in free if rng.random() < PUSHED]
        pushed = [
            Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=(self._drawing.pushed(rng, entry, sense),))
            for entry, sense in chosen
        ]
        told = asked.union(entry.name for entry, _ in hint.pushed)
        read = [entry for entry in hint.read if entry.kind == "parameter" and entry.name not in told]
        moved = [entry for entry in read if rng.random() < MOVED_OFF]  # at its default it shows nothing
        return (*pushed, *(self._drawing.moved(rng, entry) for entry in moved))

    def _away(self, rng: Rng, hint: Hint) -> tuple[Stimulus, ...]:
        """Return an order to leave home, for a rule that wants the vehicle away from it."""
        if not hint.far_m or ("command", MOVES) not in self._have or rng.random() >= AWAY:
            return ()
        place = away(rng, hint.far_m, usual_height_m(hint) * 2.0 ** rng.uniform(-1.0, 1.0))
        return (Stimulus(at_s=0.0, kind="command", name=MOVES, values=place),)

    def _act(self, rng: Rng, hint: Hint) -> tuple[Stimulus, ...]:
        """Return a command or stick of the rule's own that moves the vehicle in the mode where its flights begin."""
        movers = [entry for entry in hint.inputs if entry.kind in ("command", "stick")]
        if not movers or rng.random() >= ACTS:
            return ()
        return (self._drawing.given(rng, movers[int(rng.integers(len(movers)))]),)

    def _mode(self, name: str) -> tuple[Stimulus, ...]:
        return (Stimulus(at_s=0.0, kind="mode", name=name),) if ("mode", name) in self._have else ()

    def _held(self, rng: Rng, hint: Hint) -> tuple[Stimulus, ...]:
        """Return a stick where the formula asks for it, mostly; where it asks for none one of the rule's own at an end.

        A limit is kept by whoever asks for nothing: what bounds speed or lean shows only under a full stick.
        """
        own = [entry for entry in hint.inputs if entry.kind == "stick" and math.isfinite(entry.high - entry.low)]
        if not hint.held and own and rng.random() < DEFLECTED:
            stick = own[int(rng.integers(len(own)))]
            end = stick.low if rng.random() < 0.5 else stick.high
            return (Stimulus(at_s=0.0, kind=stick.kind, name=stick.name, values=(end,)),)
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

    def _orders(self, rng: Rng, hint: Hint) -> tuple[Stimulus, ...]:
        """Return commands the rule is about, each to be followed by nothing but quiet; now and then none."""
        orders = hint.orders()
        if not orders or rng.random() >= ORDERED:
            return ()
        many = 1 + int(rng.random() < ONE_MORE)
        return tuple(self._drawing.given(rng, orders[int(rng.integers(len(orders)))]) for _ in range(many))

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
        names = (about or own or every) if way < ABOUT else (own or about or every) if way < OWN_MODE else every
        if not names or (mode in names and rng.random() < STAYS):
            return ()
        name = pick(rng, names, [self._worth(hint, name) for name in names])
        return (Stimulus(at_s=0.0, kind="mode", name=name),)
