"""Which finds are one behaviour, and who stands for it: the first find of each is confirmed, the others are counted.

Test cases are placed in the order in which they were selected, each as soon as all before it were judged, and a find
of a behaviour whose representative is being confirmed waits for it. So whatever comes back first, the same finds are
re-flown. Where a representative does not hold under other noise, the next find in line takes its place.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from functools import cache, partial

from saflite.campaign.engine.core import Core
from saflite.campaign.lifecycle.confirmation import Trial, violated_verdicts
from saflite.contract.ids import short_id
from saflite.contract.verdict import Verdict, Violation
from saflite.flight.track_shape import Shape, first_like, shape_of


@dataclass(slots=True)
class Behaviour:
    """One way to violate a rule: the words that all its finds share, the cause and the track of the first."""

    fingerprint: str
    policy: str
    words: str
    cause: tuple[str, ...]
    shape: Shape
    founder: str  # the test case that was the first to show it
    representative: str = ""  # the test case that has confirmed it
    line: list[str] = field(default_factory=list)  # finds not decided upon, in order; the first stands for all
    stood: dict[str, bool] = field(default_factory=dict)  # of those in line that have ended: whether they confirm it

    def may_be(self, verdict: Verdict, words: str) -> bool:
        """Whether a find on a like track is this behaviour: the same policy, in the same words, given its inputs."""
        return (self.policy, self.words) == (verdict.policy, words) and set(self.cause) <= set(verdict.cause)


class Behaviours:
    """All behaviours of a campaign."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._expected: deque[str] = deque()  # test cases selected, in order, not placed yet
        self._undecided: list[str] = []  # placed, in order, not decided upon
        self._known: dict[str, Behaviour] = {}
        self._by_words: dict[str, list[Behaviour]] = {}  # the same ones
        self._told: dict[str, dict[str, str]] = {}  # by test case: what the line being applied says of its finds
        self._placed: list[Trial] = []  # by the line being applied

    @property
    def representatives(self) -> dict[str, str]:
        """The test cases that have confirmed a behaviour, by its fingerprint."""
        return {name: one.representative for name, one in self._known.items() if one.representative}

    def represents(self, violation: Violation) -> bool:
        """Whether the test case of a violation has confirmed the behaviour that it is."""
        return self._known[violation.fingerprint].representative == violation.test_case

    def is_first(self, violation: Violation) -> bool:
        """Whether no other behaviour that violates the policy was found before; alike whatever comes back first."""
        first = self._first(violation.policy)
        return first is None or first.fingerprint == violation.fingerprint

    def leads(self, trial: Trial, policy: str) -> bool:
        """Whether no find before that of the test case violated the policy; alike whatever comes back first."""
        first = self._first(policy)
        return first is None or first.founder == trial.name

    def has_stood(self, policy: str) -> bool:
        """Whether a find that violates the policy was confirmed already; which is the first depends on timing."""
        return any(one.policy == policy and one.representative for one in self._known.values())

    def _first(self, policy: str) -> Behaviour | None:
        """Return None where a journal of an earlier version takes its finds for behaviours of another policy."""
        return next((one for one in self._known.values() if one.policy == policy), None)

    def expect(self, trial: Trial) -> None:
        """Note that a test case was selected; in order."""
        self._expected.append(trial.name)

    def decided(self) -> list[tuple[Trial, bool]]:
        """Return the test cases that are decided upon now, and whether they are to be flown again."""
        trials = self._core.trials
        while self._expected and (
            (trial := trials.get(self._expected[0])) is None or trial.judgement is not None
        ):  # ended, or judged
            self._expected.popleft()
            if trial is not None and trial.waiting:
                self._place(trial)
        decided = []
        for trial in [trials[name] for name in self._undecided]:
            mine = [self._known[name] for name in trial.behaviours.values()]
            stands = any(one.line[:1] == [trial.name] for one in mine)
            if stands or all(one.representative for one in mine):
                trial.waiting = False
                self._undecided.remove(trial.name)
                decided.append((trial, stands))
        return decided

    def expect_placed(self, told: dict[str, dict[str, str]]) -> None:
        """Begin a line that says of test cases what behaviours their finds are, by policy."""
        assert not self._told, f"{sorted(self._told)} were to be placed"
        self._told, self._placed = told, []

    def placed_now(self) -> list[tuple[str, dict[str, str]]]:
        """Return the test cases placed since, in order, and what behaviours their finds are, by policy."""
        return [(trial.name, trial.behaviours) for trial in self._placed]

    def ended(self, trial: Trial) -> None:
        """Note that a test case has ended, and which of its violations stood: the next in line may stand for all."""
        for policy, fingerprint in trial.behaviours.items():
            behaviour = self._known[fingerprint]
            if trial.name in behaviour.line:
                behaviour.stood[trial.name] = policy in trial.stood
                self._advance(behaviour)

    def _place(self, trial: Trial) -> None:
        assert trial.judgement is not None, f"{trial.name} was not judged"
        told, shape = self._told.pop(trial.name, {}), cache(partial(_shape_of, trial))
        for verdict in violated_verdicts(trial.judgement):
            if verdict.policy in trial.behaviours:
                continue  # campaigns of earlier versions may name a policy twice
            words, name = verdict.behaviour or f"{verdict.policy} of {trial.name}", told.get(verdict.policy)
            behaviour = self._like(verdict, words, shape()) if name is None else self._known.get(name)
            if behaviour is None:
                name = name or short_id(f"{words}\x1f{len(self._by_words.get(words, ()))}".encode())
                behaviour = self._found(Behaviour(name, verdict.policy, words, verdict.cause, shape(), trial.name))
                trial.founded += 1
            trial.behaviours[verdict.policy] = behaviour.fingerprint
            if not behaviour.representative:
                behaviour.line.append(trial.name)
        self._undecided.append(trial.name)
        self._placed.append(trial)

    def _like(self, verdict: Verdict, words: str, shape: Shape) -> Behaviour | None:
        known = [one for one in self._by_words.get(words, ()) if one.may_be(verdict, words)]
        place = first_like(shape, [one.shape for one in known])
        return None if place is None else known[place]

    def _found(self, behaviour: Behaviour) -> Behaviour:
        self._known[behaviour.fingerprint] = behaviour
        self._by_words.setdefault(behaviour.words, []).append(behaviour)
        return behaviour

    def index(self) -> None:
        """Work out what is not kept in a snapshot."""
        for behaviour in self._known.values():
            self._by_words.setdefault(behaviour.words, []).append(behaviour)

    def _advance(self, behaviour: Behaviour) -> None:
        """Have the first in line decide once it has ended: it has confirmed the behaviour, or the next one is asked."""
        while behaviour.line and behaviour.line[0] in behaviour.stood:
            first = behaviour.line.pop(0)
            if behaviour.stood.pop(first):
                behaviour.representative = first
                behaviour.line, behaviour.stood = [], {}
                self._core.counts.behaviours += 1


def _shape_of(trial: Trial) -> Shape:
    """Return the shape of the first flight's track; without boxes no track tells two behaviours apart."""
    assert trial.judgement is not None, f"{trial.name} was not judged"
    return shape_of(trial.judgement.track if trial.test_case.scenario.obstacles else ())
