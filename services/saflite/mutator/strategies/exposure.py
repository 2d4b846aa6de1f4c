"""Exposure search over timed inputs: attention rotates over the policies, a model of the target's states is covered.

A test case is a start (a policy's own, any mode at any height, the ground, a short mission) and a few phases: into a
state, some inputs close together, quiet. The kind of an input is drawn before its name; names come from the policy's
own list or from all the target has, weighted by how far earlier flights with them came (learnt relevance). A random
part of the kinds is left out of each phase (swarm testing, Groce et al. 2012). A rule whose antecedent comes nearer to
true is progress, as is coverage of (state before, state after, kind of input, kind of the one before). What came
furthest for a policy or covered something new is kept in a corpus and changed: values and times by steps of any size,
spliced, extended. Routes to states seldom tried are read from the state model.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import ClassVar

import msgspec
import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Origin, Scenario, TestCase
from saflite.contract.work import Outcome
from saflite.mutator.exposure import numbers
from saflite.mutator.exposure.attention import NEAR, Attention, note
from saflite.mutator.exposure.corpus import Corpus, Entry, read_sown
from saflite.mutator.exposure.drawing import Drawing, Shares, Style
from saflite.mutator.exposure.hints import SHAPE, Hint, read_hints
from saflite.mutator.exposure.phases import TAIL_S, Draw, Phase, Script, Stimuli, Tempo, cut, shifted
from saflite.mutator.exposure.plans import Planner
from saflite.mutator.exposure.probes import Probes
from saflite.mutator.exposure.procedures import SHAPE as PROCEDURE_SHAPE
from saflite.mutator.exposure.procedures import Procedure, read_procedures
from saflite.mutator.exposure.progress import answers, applied_s, by_policy
from saflite.mutator.exposure.recipes import Recipes
from saflite.mutator.exposure.scenarios import Scenarios, items_of, scenarios_of
from saflite.mutator.exposure.state_model import StateModel
from saflite.mutator.exposure.survival import Survival
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.tried import Tried
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.exposure.writer import Memory, Writer
from saflite.mutator.operators import inputs
from saflite.mutator.operators.inputs import Have
from saflite.mutator.operators.sequences import moved_to_start
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

Rng = np.random.Generator
CALM = 0.6  # share of flights of a drawn mission that are left to themselves
AIRBORNE_S = (20.0, 40.0)  # a mission takes off after about 20 s
BEFORE_TAKEOFF = 0.15  # share of flights of a drawn mission with inputs on the ground, too
ITEM_CHANGED = 0.5  # share of changes of a kept flight of a drawn mission that change the mission
SETTLE_LEAST_S = 1.5
SHIFT_S = (0.05, 15.0)
SECONDS_EACH = 32.0  # of a fresh test case for one policy: it is for as many as fit, since what comes late ends flights
COVERING = 0.3  # share of changed flights, where a policy had no near miss, that change one that covered something new
GROUND_AT_ONCE = 2  # policies whose phases begin on the ground, in one flight: the others are for those that fly
POLICIES_MOST = 60  # however long it is


class Strategy:
    """The parts in `mutator/exposure`, told in order, and the draws from them."""

    proposes: ClassVar[Proposes] = "stimuli"
    options: ClassVar[Options] = {
        "hints": Option(
            [],
            f"what is known of each policy before any flight: {SHAPE}",
        ),
        "procedures": Option([], f"how rules are put to the test: {PROCEDURE_SHAPE}"),
        "others": Option(
            [], "the same for other rules about the same modes: what flies there flies for the policy, too"
        ),
        "lent": Option(0.25, "share of phases that follow a procedure of such a rule, where there are some", 0, 1),
        "followed": Option(0.6, "share of phases that follow a procedure of their policy where it has some", 0, 1),
        "crossed": Option(0.3, "share of these, in the air, that begin while one of another policy is under way", 0, 1),
        "own": Option(0.75, "share of inputs from the policy's own list; the rest from all the target has", 0, 1),
        "starts": Option(0.3, "share of fresh test cases that begin in any mode at any height", 0, 1),
        "missions": Option(0.0, "share of fresh test cases that fly a short mission drawn for them", 0, 1),
        "kept": Option(0.08, "share of test cases that change one of the corpus", 0, 1),
        "routed": Option(0.04, "share of test cases that go to a state and a kind of input seldom tried there", 0, 1),
        "recalled": Option(0.5, "share of phases that give again, changed, what made the rule apply before", 0, 1),
        "swarm": Option(0.8, "chance of a kind of the policy's own inputs; half that for others", 0.05, 1),
        "faults": Option(0.15, "the same for sensor faults beyond the policy's own: a fault excuses most rules", 0, 1),
        "paired": Option(0.2, "share of other test cases that fly with a twin, where rules compare with one", 0, 1),
        "beyond": Option(0.15, "share of values outside their valid range; 0: none", 0, 1),
        "phases_max": Option(5, "greatest number of phases in a test case", 1, 20),
        "settle_max_s": Option(20.0, "longest quiet at the end of a phase", 2, 600),
        "corpus": Option([], "kept flights of an earlier run to begin with (`saflite run --corpus RUN`)"),
        "start_s": Option(0.5, "time of the first input", 0, 600),
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings.

        Raises Refused for a bad one, an input the target does not have, no policy, or a template without start and
        mission.
        """
        self._chosen = Chosen(settings, self.options)
        if not policies:
            raise Refused("strategy", expected="a campaign with at least one policy", got="none")
        if template.scenario.start is None and template.scenario.mission is None:
            raise Refused("strategy", expected="a campaign with a start state or a mission", got="neither")
        self._in_range = self._chosen.real("beyond") == 0.0
        self._have = all_there_are = inputs.target_inputs(target, template.target.settings)
        lacking = target.lacking(template.target.settings)
        if self._in_range:  # of what has no documented range nobody can say whether a value is within
            lacking |= {entry.name for entry in self._have.values() if not numbers.has_range(entry)}
            self._have = {key: entry for key, entry in self._have.items() if entry.name not in lacking}
        if not self._have:
            raise Refused("strategy", expected="a target with inputs to give", got=f"{target.name}, which has none")
        self._template = template
        self._at_start = frozenset(key for key, entry in self._have.items() if entry.at_start)
        texts = [_without(text, lacking) for text in self._chosen.words("hints")]
        hints = read_hints(texts, policies, self._have)
        self._hints = {hint.policy: hint for hint in hints}
        self._twins = tuple(dict.fromkeys(hint.twin for hint in hints if hint.twin))
        self._rest = {(entry.kind, entry.name): entry.default for entry in target.inputs if entry.default is not None}
        self._rest.update({("parameter", name): value for name, value in template.target.parameters.items()})
        self._probes = Probes({} if self._in_range else self._have)
        self._taken, self._survival, self._tried = Taken(), Survival(), Tried()
        self._scenarios: Scenarios = scenarios_of(template.scenario, target, self._tried)
        self._vocabulary = Vocabulary(self._have, self._taken)
        self._attention, self._states = Attention(policies), StateModel()
        shares = Shares(*(self._chosen.real(name) for name in Shares._fields))
        self._drawing = Drawing(self._vocabulary, self._rest, shares)
        self._recipes = Recipes({hint.policy: hint.quiet_s for hint in hints})
        followed, crossed, lent = (self._chosen.real(name) for name in ("followed", "crossed", "lent"))
        self._plans = Planner(self._states, self._survival, self._tried, followed, crossed, lent)
        told = read_procedures(self._chosen.words("procedures"), policies, all_there_are)
        others = read_procedures(self._chosen.words("others"), None, all_there_are)
        self._plans.tell_of(
            hints,
            {name: tuple(_drawable(found, self._have)) for name, found in told.items()},
            [tuple(_drawable(found, self._have)) for found in others.values()],
        )
        memory = Memory(self._states, self._recipes, self._taken, self._plans)
        self._writer = Writer(self._have, self._drawing, self._probes, memory, self._chosen.real("recalled"))
        self._writer.tell_of(hints)
        self._corpus = Corpus()
        for sown in read_sown(self._chosen.words("corpus")):
            case = msgspec.structs.replace(template, scenario=sown.scenario, stimuli=sown.stimuli)
            self._corpus.tell(case, sown.progress, sown.new)

    # ---- tell --------------------------------------------------------------------------------------------------

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Learn from flights that said something."""
        for outcome in outcomes:
            if outcome.ending not in FLOWN_ENDINGS:
                continue
            case, progress = outcome.test_case, by_policy(outcome)
            given, taken = answers(outcome)
            crashed = outcome.ending == "crashed"
            self._probes.tell(case, given, taken, ended=crashed or bool(outcome.violated))
            self._vocabulary.tell(case, progress, given, taken)
            self._taken.tell(case, outcome.transitions, given, taken)
            self._survival.tell(case, outcome.transitions, crashed=crashed)
            self._tried.tell(case, given, items_of(mission) if (mission := case.scenario.mission) is not None else ())
            self._attention.tell(case, progress)
            self._recipes.tell(case, applied_s(outcome), sorted(taken))
            self._corpus.tell(case, progress, self._states.tell(case, outcome.transitions, crashed=crashed))

    # ---- ask ---------------------------------------------------------------------------------------------------

    def ask(self, count: int, rng: Rng) -> list[TestCase]:
        """Return `count` test cases; each is for a few policies that want the same kind of start."""
        each = max(1, round(min(POLICIES_MOST, self._template.scenario.time_limit_s / SECONDS_EACH)))
        self._tried.begin()
        lax = self._probes.singled_out
        suspected = {hint.policy for hint in self._hints.values() if lax.intersection(hint.names())}
        rotation = self._attention.rotation(rng, each * count, suspected)
        wanted = self._in_flights(rotation)
        groups = [tuple(wanted[place * each :][:each]) for place in rng.permutation(count)]
        return [self._paired(rng, self._one(rng, self._led(group)), group) for group in groups]

    def _paired(self, rng: Rng, case: TestCase, policies: Sequence[str]) -> TestCase:
        """Return the test case with the twin that one of its policies compares with, now and then with any of them."""
        if not self._twins:
            return case
        asked = [twin for name in policies if (twin := self._hints[name].twin)]
        if not asked and rng.random() >= self._chosen.real("paired"):
            return case
        among = asked or self._twins
        return msgspec.structs.replace(case, twin=among[int(rng.integers(len(among)))])

    def _in_flights(self, rotation: Sequence[str]) -> list[str]:
        """Return the policies as they share flights: missions together, a few begun on the ground before many flown."""
        begun: dict[str, list[str]] = {"mission": [], "ground": [], "air": []}
        for name in rotation:
            begun[self._hints[name].begins].append(name)
        ground, air = begun["ground"], begun["air"]
        ends = np.linspace(0, len(air), max(1, math.ceil(len(ground) / GROUND_AT_ONCE)) + 1).astype(int)
        shared = [
            name
            for place, (first, last) in enumerate(pairwise(ends.tolist()))
            for name in (*ground[place * GROUND_AT_ONCE :][:GROUND_AT_ONCE], *air[first:last])
        ]
        return [*begun["mission"], *shared]

    def _led(self, policies: tuple[str, ...]) -> tuple[str, ...]:
        """Return the policies, one that only a mission can show first: the first decides how the flight begins."""
        return tuple(sorted(policies, key=lambda name: not self._hints[name].flies_mission))

    def _one(self, rng: Rng, policies: tuple[str, ...]) -> TestCase:
        way = rng.random()
        if way < self._chosen.real("kept"):
            parent = self._parent(rng, policies[0])
            if parent is not None:
                how, scenario, stimuli = self._change(rng, parent, policies)
                return self._made(scenario, stimuli, note(policies[:1], how), parent.identity)
        elif way < self._chosen.real("kept") + self._chosen.real("routed"):
            routed = self._routed(rng, policies[0])
            if routed is not None:
                return routed
        tasks = self._plans.in_turn(rng, [self._hints[policy] for policy in dict.fromkeys(policies)])
        scenario = self._scenario(rng, tasks[0].hint)
        tempo, many = self._tempo(rng, scenario), self._chosen.whole("phases_max")
        if self._is_drawn_mission(scenario) and rng.random() < CALM:
            before = tempo._replace(first_s=self._chosen.real("start_s"))
            calm = self._writer.calm(rng, before, [task.hint for task in tasks])
            return self._made(scenario, calm, note(policies, "calm"))
        made, spans = self._writer.fresh(rng, tempo, scenario.start, tasks, many)
        return self._made(scenario, made, note((), "fresh", spans))

    def _made(self, scenario: Scenario, stimuli: Stimuli, text: str, parent: str = "") -> TestCase:
        origin = Origin(strategy="exposure", parent=parent, note=text)
        if self._at_start:
            stimuli = moved_to_start(stimuli, self._at_start)
        if self._in_range:  # neither changes nor an earlier run's corpus know of it
            stimuli = numbers.in_range(self._have, stimuli)
        return msgspec.structs.replace(self._template, scenario=scenario, stimuli=stimuli, origin=origin)

    # ---- fresh test cases --------------------------------------------------------------------------------------

    def _scenario(self, rng: Rng, hint: Hint) -> Scenario:
        scenarios, way = self._scenarios, rng.random()
        if scenarios.own.mission is not None:
            drawn = scenarios.missions and way < self._chosen.real("missions")
            return scenarios.mission(rng) if drawn else scenarios.own
        if scenarios.missions and (hint.flies_mission or way < self._chosen.real("missions")):
            return scenarios.mission(rng)
        if way < self._chosen.real("missions") + self._chosen.real("starts"):
            return scenarios.anywhere(rng)
        if hint.start is None:
            return scenarios.own
        return scenarios.elsewhere(rng, hint.start) if rng.random() < 0.5 else scenarios.begin(hint.start)

    def _is_drawn_mission(self, scenario: Scenario) -> bool:
        return scenario.mission not in (None, self._template.scenario.mission)

    def _tempo(self, rng: Rng, scenario: Scenario) -> Tempo:
        first_s = self._chosen.real("start_s")
        if self._is_drawn_mission(scenario) and rng.random() >= BEFORE_TAKEOFF:
            first_s = float(rng.uniform(*AIRBORNE_S))
        last_s = max(first_s, scenario.time_limit_s - TAIL_S)
        return Tempo(first_s, last_s, (SETTLE_LEAST_S, self._chosen.real("settle_max_s")), self._rest)

    # ---- changing what is kept ---------------------------------------------------------------------------------

    def _parent(self, rng: Rng, policy: str) -> Entry | None:
        """Return a near miss of the policy, now and then a flight that covered something new; None for neither."""
        best = self._corpus.best(policy)
        if best is not None and best.progress >= NEAR:
            return best
        return self._corpus.covering(rng) if rng.random() < COVERING else None

    def _change(self, rng: Rng, parent: Entry, policies: Sequence[str]) -> tuple[str, Scenario, Stimuli]:
        """Return a changed flight, and how: a drawn mission with another item, or one or two changes of its inputs."""
        scenario, stimuli, names = parent.scenario, parent.stimuli, []
        if scenario.mission is not None and self._is_drawn_mission(scenario) and rng.random() < ITEM_CHANGED:
            other = self._scenarios.changed(rng, scenario.mission)
            return "item", msgspec.structs.replace(scenario, mission=other), stimuli
        tempo = self._tempo(rng, scenario)
        for _ in range(1 if rng.random() < 0.6 else 2):
            way = ("value", "value", "time", "splice", "extend", "replace", "drop")[int(rng.integers(7))]
            if not stimuli or (way == "drop" and len(stimuli) == 1):
                way = "extend"
            stimuli = self._changed(rng, way, stimuli, tempo, policies)
            names.append(way)
        return "+".join(names), scenario, stimuli

    def _changed(self, rng: Rng, way: str, stimuli: Stimuli, tempo: Tempo, policies: Sequence[str]) -> Stimuli:
        place = int(rng.integers(len(stimuli))) if stimuli else 0
        draw = partial(self._drawing.draw, self._drawing.style(rng, self._hints[policies[0]]))
        match way:
            case "value":
                return self._nudged(rng, stimuli, place)
            case "time":
                low, high = (math.log(shift_s) for shift_s in SHIFT_S)
                by_s = math.exp(rng.uniform(low, high)) * (1.0 if rng.random() < 0.5 else -1.0)
                return shifted(stimuli, place, by_s, tempo) or stimuli
            case "splice":
                return self._spliced(rng, stimuli)
            case "replace":
                new = msgspec.structs.replace(draw(rng), at_s=stimuli[place].at_s)
                return (*stimuli[:place], new, *stimuli[place + 1 :])
            case "drop":
                return (*stimuli[:place], *stimuli[place + 1 :])
            case _:
                return self._extended(rng, stimuli, tempo, draw)

    def _nudged(self, rng: Rng, stimuli: Stimuli, place: int) -> Stimuli:
        old = stimuli[place]
        entry = self._have.get((old.kind, old.name))
        if entry is None:
            return stimuli
        new = numbers.nudge(rng, entry, old)
        if rng.random() < 0.4:
            given = numbers.draw(rng, entry, self._rest.get((old.kind, old.name)), self._chosen.real("beyond"))
            new = msgspec.structs.replace(old, values=given)
        return (*stimuli[:place], new, *stimuli[place + 1 :])

    def _spliced(self, rng: Rng, stimuli: Stimuli) -> Stimuli:
        """Return the beginning of one kept sequence with the end of another, cut at one moment."""
        other = self._corpus.any(rng)
        if other is None or not other.stimuli:
            return stimuli
        at_s = stimuli[int(rng.integers(len(stimuli)))].at_s
        return (*cut(stimuli, at_s), *(one for one in other.stimuli if one.at_s > at_s))

    def _extended(self, rng: Rng, stimuli: Stimuli, tempo: Tempo, draw: Draw) -> Stimuli:
        """Return the sequence up to some input, with a new phase after it."""
        if not stimuli:
            first_s = tempo.first_s
        else:
            end = len(stimuli) if rng.random() < 0.6 else int(rng.integers(len(stimuli))) + 1
            stimuli = stimuli[:end]
            first_s = min(tempo.last_s, stimuli[-1].at_s + float(rng.uniform(0.1, 8.0)))
        script = Script(tempo, stimuli, first_s)
        script.phase(rng, Phase(draw))
        return script.stimuli()

    def _routed(self, rng: Rng, policy: str) -> TestCase | None:
        """Return a test case that goes to a state and gives a kind of input seldom or never given there."""
        goal = self._states.goal(rng, self._vocabulary.kinds)
        way = self._states.route(goal[0]) if goal is not None else None
        if goal is None or way is None:
            return None
        scenario, route = way
        if self._is_drawn_mission(scenario):
            return None
        script = Script(self._tempo(rng, scenario))
        for stimulus in route:
            script.give(stimulus)
            script.pause(rng, 1.0, 6.0)
        hint = self._hints[policy]
        script.phase(rng, Phase(partial(self._drawing.draw, Style(hint, (goal[1],)))))
        mode = ""
        while not script.is_full:
            mode = self._writer.phase(rng, script, self._drawing.style(rng, hint), mode)
        return self._made(scenario, script.stimuli(), note((policy,), f"to {goal[0].replace(' ', '-')}"))


def _without(text: str, lacking: Collection[str]) -> str:
    """Return a hint without the inputs that cannot be given with the target's settings."""
    return " ".join(word for word in text.split() if word.rpartition(":")[2].partition("=")[0] not in lacking)


def _drawable(procedures: Iterable[Procedure], have: Have) -> Iterator[Procedure]:
    """Yield those that leave no value open of an input that is not drawn; one that tells the value may give any."""
    for one in procedures:
        open_ones = (entry for step in one.steps if step.usual for entry in step.entries)
        if all((entry.kind, entry.name) in have for entry in open_ones):
            yield one
