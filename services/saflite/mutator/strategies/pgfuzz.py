"""PGFuzz's search (NDSS 2021) over timed inputs: parameters, commands, sticks, modes and sensor faults.

A test case is a sequence of inputs given from the campaign's start state, one per round of 4 s. The class of an input
is drawn first (command, parameter, environment), then the input evenly from its list, then its value: fresh, or one
that brought an earlier flight closer to a violation. Distance is `Outcome.guidance`: the policies' robustness, or how
far their rules were from applying.

Beyond the published tool: guidance also chooses *inputs* (sequences that came close are kept and changed: add, replace,
revalue, retime, drop, join), inputs can come in bursts, a share of draws (`focus`) comes from the policy's own
inputs, values can leave their valid range, be negative, be those of another parameter of the case, and are never stuck
at 0 for want of bounds.
"""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Origin, Stimulus, StimulusKind, TestCase, draw_key, identity
from saflite.contract.work import GUIDANCE_FAR, Outcome
from saflite.mutator.operators import inputs, sequences, values
from saflite.mutator.operators.inputs import Have, Input
from saflite.mutator.operators.sequences import Rhythm, Stimuli
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

POOL_MAX = 24
FAR = GUIDANCE_FAR / (
    1.0 + GUIDANCE_FAR
)  # the closeness of a flight in which nothing brought a rule nearer to applying
WILD, WILD_SHARE = 3.0, 0.2  # cases whose values leave their range this many times as often, and how many do
TAIL_S = 8.0  # least time left after the last stimulus, for its effect to show
_CLASS_OF: dict[StimulusKind, str] = {
    "command": "command",
    "stick": "command",
    "mode": "command",
    "parameter": "parameter",
    "sensor_fault": "environment",
}
_CHANGES = ("add", "add", "replace", "revalue", "revalue", "retime", "drop", "join")
_OWN: dict[str, StimulusKind] = {
    "parameters": "parameter",
    "commands": "command",
    "sticks": "stick",
    "modes": "mode",
    "sensor_faults": "sensor_fault",
}

Key = tuple[StimulusKind, str]


class Seed(NamedTuple):
    """A sequence that came close without violating."""

    stimuli: Stimuli
    identity: str
    draw_key: str
    guidance: float


class Style(NamedTuple):
    """What the inputs of one test case have in common: shares of inputs of the policy's own, of values out of range."""

    focus: float
    beyond: float


class Kept(NamedTuple):
    """The values of an input in the flight it came closest in, and how close that was."""

    values: tuple[float, ...]
    closeness: float


def closeness(guidance: float) -> float:
    """Return a number that guides on a scale from -1 to 1, so that metres and yes-or-no can be compared."""
    return guidance / (1.0 + abs(guidance))


class Strategy:
    """The seed pool and the values that helped."""

    proposes: ClassVar[Proposes] = "stimuli"
    options: ClassVar[Options] = {
        "parameters": Option([], "parameters of the policy's own inputs"),
        "commands": Option([], "commands of the policy's own inputs (MAV_CMD names, Flight_Mode for any mode)"),
        "sticks": Option([], "sticks of the policy's own inputs (of the reference: RC1 to RC4)"),
        "modes": Option([], "flight modes of the policy's own inputs"),
        "sensor_faults": Option([], "sensor faults of the policy's own inputs (of the reference: SIM_* names)"),
        "published": Option("", "draw the rest from this policy's PGFuzz list, e.g. A.CHUTE; empty: all of the target"),
        "focus": Option(0.5, "share of cases, and of inputs in the others, from the policy's own (0: as PGFuzz)", 0, 1),
        "guided": Option(0.5, "share of values reused from flights that came closer", 0, 1),
        "mutated": Option(0.5, "share of test cases that change a close one (0: as PGFuzz)", 0, 1),
        "beyond": Option(0.2, "share of values outside their valid range; thrice that in a fifth of cases", 0, 1),
        "echoed": Option(0.15, "share of cases with one parameter set to the value of another (0: as PGFuzz)", 0, 1),
        "bursts": Option(0.4, "share of inputs that follow within 2 s instead of a round (0: as PGFuzz)", 0, 1),
        "release": Option(0.7, "share of stick inputs let go after their round (1: as PGFuzz)", 0, 1),
        "steps_min": Option(3, "least number of inputs in a test case", 1, 100),
        "steps_max": Option(14, "greatest number of inputs in a test case", 1, 100),
        "round_s": Option(4.0, "time from one input to the next", 0.1, 60),
        "start_s": Option(1.0, "time of the first input", 0, 60),
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings.

        Raises Refused for a bad one, an input the target does not have, or a template without start and mission.
        """
        self._chosen = Chosen(settings, self.options)
        scenario = template.scenario
        if scenario.start is None and scenario.mission is None:
            raise Refused("strategy", expected="a campaign with a start state or a mission", got="neither")
        if self._chosen.whole("steps_min") > self._chosen.whole("steps_max"):
            got = f"{self._chosen.whole('steps_min')} and {self._chosen.whole('steps_max')}"
            raise Refused("strategy settings steps_min, steps_max", expected="steps_min at most steps_max", got=got)
        self._template = template
        have = inputs.target_inputs(target, template.target.settings)
        if not have:
            raise Refused("strategy", expected="a target with inputs to give", got=f"{target.name}, which has none")
        self._rhythm = self._read_rhythm(scenario.time_limit_s, have)
        self._own = self._read_own(have, target.lacking(template.target.settings))
        self._broad = self._read_broad(have)
        self._inputs = {(entry.kind, entry.name): entry for entry in (*self._broad, *self._own)}
        self._at_start = frozenset(key for key, entry in self._inputs.items() if entry.at_start)
        self._seeds: dict[tuple[Key, ...], Seed] = {}
        self._kept: dict[Key, Kept] = {}
        self._told: dict[str, float] = {}
        self._ordered: list[float] = []

    def _read_rhythm(self, time_limit_s: float, have: Have) -> Rhythm:
        start_s, round_s = self._chosen.real("start_s"), self._chosen.real("round_s")
        last_s = max(start_s, time_limit_s - TAIL_S)
        return Rhythm(
            start_s=start_s,
            round_s=round_s,
            bursts=self._chosen.real("bursts"),
            release=self._chosen.real("release"),
            last_s=last_s,
            steps_max=self._chosen.whole("steps_max"),
            rest={entry.name: entry.rest for entry in have.values() if not math.isnan(entry.rest)},
        )

    def _read_own(self, have: Have, lacking: Collection[str]) -> tuple[Input, ...]:
        """Return the policy's own inputs, but for those that cannot be given with the target's settings."""
        found: list[Input] = []
        for setting, kind in _OWN.items():
            words = [word for word in self._chosen.words(setting) if word not in lacking]
            found.extend(inputs.named(kind, words, have, setting))
        return tuple(dict.fromkeys(found))

    def _read_broad(self, have: Have) -> tuple[Input, ...]:
        """Return the list everything else is drawn from: the published one as far as the target has it, or all."""
        published = self._chosen.text("published")
        everything = tuple(have.values())
        if not published:
            return everything
        found = inputs.on_target(inputs.published_inputs(published), have)
        return found if any(entry.kind == "parameter" for entry in found) else everything

    # ---- tell --------------------------------------------------------------------------------------------------

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Keep sequences that came close and values that helped; a violating one is done with."""
        for outcome in outcomes:
            if outcome.ending not in FLOWN_ENDINGS or outcome.guidance is None or not outcome.test_case.stimuli:
                continue
            self._credit(outcome)
            self._keep(outcome)

    def _credit(self, outcome: Outcome) -> None:
        """Store the values of a flight closer than its parent (or than half of all), but for those of closer ones."""
        assert outcome.guidance is not None, "only flights that said something are credited"
        case, now = outcome.test_case, closeness(outcome.guidance)
        usual = self._ordered[len(self._ordered) // 2] if self._ordered else FAR
        before = self._told.get(case.origin.parent, usual)
        self._told[identity(case)] = now
        insort(self._ordered, now)
        if now >= before:
            return
        for stimulus in case.stimuli:
            key = (stimulus.kind, stimulus.name)
            held = self._kept.get(key)
            if held is None or now <= held.closeness:
                self._kept[key] = Kept(stimulus.values, now)

    def _keep(self, outcome: Outcome) -> None:
        assert outcome.guidance is not None, "only flights that said something are kept"
        case = outcome.test_case
        kind_of_sequence = tuple(sorted((stimulus.kind, stimulus.name) for stimulus in case.stimuli))
        held = self._seeds.get(kind_of_sequence)
        if outcome.violated:
            self._seeds.pop(kind_of_sequence, None)
            return
        if held is None or outcome.guidance < held.guidance:
            self._seeds[kind_of_sequence] = Seed(case.stimuli, identity(case), draw_key(case), outcome.guidance)
        if len(self._seeds) > POOL_MAX:
            worst = max(self._seeds, key=lambda key: (self._seeds[key].guidance, key))
            del self._seeds[worst]

    # ---- ask ---------------------------------------------------------------------------------------------------

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        """Return `count` sequences: some changed from close ones, the rest fresh."""
        pool = sorted(self._seeds.values(), key=lambda seed: (seed.guidance, seed.draw_key))
        return [self._one(rng, pool) for _ in range(count)]

    def _one(self, rng: np.random.Generator, pool: list[Seed]) -> TestCase:
        style = self._style(rng)
        if pool and rng.random() < self._chosen.real("mutated"):
            parent = pool[min(len(pool) - 1, int(len(pool) * rng.random() ** 2))]  # the close ones more often
            change, stimuli = self._change(rng, parent, pool, style)
            return self._made(rng, stimuli, parent.identity, change)
        stimuli = sequences.fresh(rng, partial(self._draw, style), self._length(rng), self._rhythm)
        return self._made(rng, stimuli, "", "fresh")

    def _length(self, rng: np.random.Generator) -> int:
        """Draw how many inputs; few more often: some rules need several, most are hidden by what does not belong."""
        least, most = self._chosen.whole("steps_min"), self._chosen.whole("steps_max")
        return least + int((most + 1 - least) * rng.random() ** 2)

    def _style(self, rng: np.random.Generator) -> Style:
        """Draw what the inputs of one case have in common: a rule that three of a kind break is met more often so."""
        focus, beyond = self._chosen.real("focus"), self._chosen.real("beyond")
        return Style(
            focus=1.0 if rng.random() < focus else focus,
            beyond=min(1.0, WILD * beyond) if rng.random() < WILD_SHARE else beyond,
        )

    def _made(self, rng: np.random.Generator, stimuli: Stimuli, parent: str, note: str) -> TestCase:
        if rng.random() < self._chosen.real("echoed"):
            stimuli = sequences.echo(rng, stimuli)
        if self._chosen.real("beyond") == 0.0:  # changes and echoes know no range
            stimuli = tuple(map(self._within, stimuli))
        if self._at_start:
            stimuli = sequences.moved_to_start(stimuli, self._at_start)
        origin = Origin(strategy="pgfuzz", parent=parent, note=note)
        return msgspec.structs.replace(self._template, stimuli=stimuli, origin=origin)

    def _change(self, rng: np.random.Generator, parent: Seed, pool: list[Seed], style: Style) -> tuple[str, Stimuli]:
        draw = partial(self._draw, style)
        change, stimuli = _CHANGES[int(rng.integers(len(_CHANGES)))], parent.stimuli
        count = sequences.steps(stimuli, self._rhythm)
        if change == "add" and count < self._rhythm.steps_max:
            return change, sequences.add(rng, stimuli, draw, self._rhythm)
        if change == "retime":
            return change, sequences.retime(rng, stimuli, self._rhythm)
        if change == "drop" and len(stimuli) > 1 and count > self._chosen.whole("steps_min"):
            return change, sequences.drop(rng, stimuli)
        if change == "join" and len(pool) > 1:
            other = pool[int(rng.integers(len(pool)))]
            return change, sequences.join(rng, stimuli, other.stimuli, self._rhythm)
        if change == "revalue":
            return change, self._revalue(rng, stimuli, style)
        return "replace", sequences.replace(rng, stimuli, draw, self._rhythm)

    def _revalue(self, rng: np.random.Generator, stimuli: Stimuli, style: Style) -> Stimuli:
        index = int(rng.integers(len(stimuli)))
        old = stimuli[index]
        entry = self._inputs.get((old.kind, old.name))
        if entry is None:
            return stimuli
        new = values.jitter(rng, entry, old.values) if rng.random() < 0.5 else self._value(rng, entry, style)
        return (*stimuli[:index], msgspec.structs.replace(old, values=new), *stimuli[index + 1 :])

    def _within(self, stimulus: Stimulus) -> Stimulus:
        entry = self._inputs.get((stimulus.kind, stimulus.name))
        if entry is None or stimulus.kind == "mode":
            return stimulus
        return msgspec.structs.replace(stimulus, values=values.within(entry, stimulus.values))

    # ---- drawing -----------------------------------------------------------------------------------------------

    def _draw(self, style: Style, rng: np.random.Generator) -> Stimulus:
        focused = bool(self._own) and rng.random() < style.focus
        entry = _pick(rng, self._own, _kind) if focused else _pick(rng, self._broad, _class)
        return Stimulus(at_s=0.0, kind=entry.kind, name=entry.name, values=self._value(rng, entry, style))

    def _value(self, rng: np.random.Generator, entry: Input, style: Style) -> tuple[float, ...]:
        held = self._kept.get((entry.kind, entry.name))
        if held is not None and rng.random() < self._chosen.real("guided"):
            return held.values
        return values.draw(rng, entry, style.beyond)


def _kind(entry: Input) -> str:
    return entry.kind


def _class(entry: Input) -> str:
    return _CLASS_OF[entry.kind]


def _pick(rng: np.random.Generator, entries: Sequence[Input], group: Callable[[Input], str]) -> Input:
    """Return an input: its group evenly first, as PGFuzz draws its classes, then the input evenly within the group."""
    groups = sorted({group(entry) for entry in entries})
    wanted = groups[int(rng.integers(len(groups)))]
    within = [entry for entry in entries if group(entry) == wanted]
    return within[int(rng.integers(len(within)))]
