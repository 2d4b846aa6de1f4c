"""The target's states as flights showed them: which input in which state led where, and what was never tried."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from saflite.contract.test_case import Scenario, Stimulus, StimulusKind, TestCase
from saflite.contract.verdict import Transition
from saflite.mutator.exposure.vocabulary import pick

Rng = np.random.Generator
Coverage = tuple[str, str, str, str]
"""State before, state after, kind of the input given (empty: changed by itself), kind of the one before it."""
STANDING, DISARMED = "standing", "disarmed"


class Leg(NamedTuple):
    """One step of a route: the input, None where the target changes by itself, and the state it leads to."""

    stimulus: Stimulus | None
    state: str


class Origin(NamedTuple):
    """A scenario whose flights begin in a known state."""

    scenario: Scenario
    state: str


class StateModel:
    """States, steps between them, and how often each kind of input was given in each."""

    def __init__(self) -> None:
        self.covered: Counter[Coverage] = Counter()
        self._legs: dict[str, dict[str, Leg]] = {}
        self._origins: dict[str, Origin] = {}
        self._given: dict[str, Counter[str]] = {}
        self._raised_by: dict[str, dict[tuple[str, str], Stimulus]] = {}
        self._raised: Counter[tuple[str, tuple[str, str]]] = Counter()  # times a word came after an input
        self._times: Counter[tuple[str, str]] = Counter()  # times an input was given
        self._flown_in: Counter[str] = Counter()  # by word of a state in the air: flights in which it was seen
        self._came_down: Counter[str] = Counter()  # those of them in which it came to the ground by itself
        self._crashed: Counter[str] = Counter()  # those that ended in it otherwise

    def tell(self, case: TestCase, transitions: Sequence[Transition], *, crashed: bool = False) -> int:
        """Add a flight, which `crashed` or not; return how many (state, state, kind, preceding kind) were new in it."""
        new = 0
        self._learn_landings(transitions, crashed=crashed)
        for number, step in enumerate(transitions):
            if number == 0:
                self._origins.setdefault(step.before, Origin(case.scenario, step.before))
            stimulus = _at(case, step.stimulus)
            seen = coverage(case, step)
            new += seen not in self.covered
            self.covered[seen] += 1
            self._given.setdefault(step.after, Counter())
            self._given.setdefault(step.before, Counter())[stimulus.kind if stimulus else ""] += 1
            self._learn_causes(case, step)
            if step.after != step.before:
                self._legs.setdefault(step.before, {}).setdefault(step.after, Leg(stimulus, step.after))
        return new

    def _learn_landings(self, transitions: Sequence[Transition], *, crashed: bool) -> None:
        flown: set[str] = set()
        down: set[str] = set()
        for step in transitions:
            flown.update(step.before.split() if flies(step.before) else ())
            if flies(step.before) and not flies(step.after) and step.stimulus < 0:
                down.update(step.before.split())
        if crashed and transitions:
            flown.update(transitions[-1].after.split())
            self._crashed.update(set(transitions[-1].after.split()) - down)
        self._flown_in.update(flown)
        self._came_down.update(down)

    def comes_down(self, words: Iterable[str]) -> float:
        """Return the share of flights that ended on the ground from states with the words: of the word with most."""
        ended = ((self._came_down[word] + self._crashed[word]) / (self._flown_in[word] + 2.0) for word in words)
        return max(ended, default=0.0)

    def crashes(self, word: str) -> float:
        """Return the share of flights with a word in their states that crashed in such a state."""
        return self._crashed[word] / (self._flown_in[word] + 2.0)

    def lands(self) -> str:
        """Return the mode in which most flights came to the ground whole, empty where none did mostly."""
        modes = sorted({state.split()[0] for state in self.states})
        shares = [(self._came_down[mode] / (self._flown_in[mode] + 2.0), mode) for mode in modes]
        share, mode = max(shares, default=(0.0, ""))
        return mode if share > 0.5 else ""

    def lift(self) -> list[Stimulus]:
        """Return the fewest inputs known to lead from the ground, motors off, into the air; none if not known."""
        ways: dict[str, list[Stimulus]] = {}
        for state in self.states:
            if state.split()[1:] == [STANDING, DISARMED]:
                ways[state] = [Stimulus(at_s=0.0, kind="mode", name=state.split()[0])]
        waiting = deque(ways)
        while waiting:
            state = waiting.popleft()
            for leg in self._legs.get(state, {}).values():
                if leg.state in ways or leg.stimulus is None or leg.stimulus.kind not in ("mode", "command", "stick"):
                    continue
                ways[leg.state] = [*ways[state], leg.stimulus]
                if flies(leg.state):
                    return ways[leg.state]
                waiting.append(leg.state)
        return []

    def _learn_causes(self, case: TestCase, step: Transition) -> None:
        """Credit the last two inputs with the words that came into the state: an effect may take its time."""
        given = [one for place in (step.stimulus, step.preceding) if (one := _at(case, place)) is not None]
        caused = _at(case, step.stimulus)
        if caused is not None and caused.kind != "mode":
            self._times[caused.kind, caused.name] += 1
        for word in sorted(set(step.after.split()) - set(step.before.split())):
            for stimulus in given:
                if stimulus.kind != "mode":
                    key = (stimulus.kind, stimulus.name)
                    self._raised_by.setdefault(word, {})[key] = stimulus
                    self._raised[word, key] += 1

    def cause(self, rng: Rng, words: Sequence[str]) -> Stimulus | None:
        """Return an input after which one of the words came into the state (a failsafe); None if none is known.

        Those that raise it in most of the times they are given rather than what happened to be given before.
        """
        known = [(word, key) for word in words for key in self._raised_by.get(word, {})]
        if not known:
            return None
        shares = [self._raised[word, key] / (self._times[key] + 1.0) for word, key in known]
        word, key = pick(rng, known, [share**2 for share in shares])
        return self._raised_by[word][key]

    @property
    def states(self) -> tuple[str, ...]:
        """The states seen so far, sorted."""
        return tuple(sorted(self._given))

    def goal(self, rng: Rng, kinds: Sequence[StimulusKind]) -> tuple[str, StimulusKind] | None:
        """Return a state and a kind of input that was seldom or never given in it; None before any flight."""
        pairs = [(state, kind) for state in self.states for kind in kinds]
        if not pairs:
            return None
        weights = np.array([1.0 / (1.0 + self._given[state][kind]) ** 2 for state, kind in pairs])
        edges = np.cumsum(weights)
        return pairs[min(int(np.searchsorted(edges, rng.random() * edges[-1], side="right")), len(pairs) - 1)]

    def route(self, goal: str) -> tuple[Scenario, list[Stimulus]] | None:
        """Return a scenario and the fewest inputs known to lead from its start to the state, None if none do."""
        if goal in self._origins:
            return self._origins[goal].scenario, []
        ways: dict[str, tuple[Scenario, list[Stimulus]]] = {
            state: (origin.scenario, []) for state, origin in sorted(self._origins.items())
        }
        waiting = deque(ways)
        while waiting:
            state = waiting.popleft()
            scenario, inputs = ways[state]
            for leg in self._legs.get(state, {}).values():
                if leg.state in ways:
                    continue
                ways[leg.state] = (scenario, [*inputs, leg.stimulus] if leg.stimulus else inputs)
                if leg.state == goal:
                    return ways[goal]
                waiting.append(leg.state)
        return None


def flies(state: str) -> bool:
    """Return whether a state is one in the air."""
    words = state.split()
    return STANDING not in words and DISARMED not in words


def coverage(case: TestCase, step: Transition) -> Coverage:
    """Return what a step covers."""
    stimulus, preceding = _at(case, step.stimulus), _at(case, step.preceding)
    return (step.before, step.after, stimulus.kind if stimulus else "", preceding.kind if preceding else "")


def _at(case: TestCase, place: int) -> Stimulus | None:
    return case.stimuli[place] if 0 <= place < len(case.stimuli) else None
