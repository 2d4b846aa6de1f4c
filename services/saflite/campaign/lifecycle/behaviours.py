"""Which finds are one behaviour, and who stands for it: the first find of each is confirmed, the others are counted.

Test cases are placed in the order in which they were selected, each as soon as all before it were judged, and a find
of a behaviour whose representative is being confirmed waits for it. So whatever comes back first, the same finds are
re-flown. Where a representative does not hold under other noise, the next find in line takes its place.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from saflite.campaign.engine.core import Core
from saflite.campaign.lifecycle.confirmation import Trial, violated_verdicts
from saflite.contract.ids import short_id
from saflite.contract.verdict import Verdict
from saflite.flight.track_shape import Shape, first_like, shape_of


@dataclass(slots=True)
class Behaviour:
    """One way to violate a rule: the words that all its finds share, the cause and the track of the first."""

    fingerprint: str
    words: str
    cause: tuple[str, ...]
    shape: Shape
    representative: str = ""  # the test case that has confirmed it
    line: list[str] = field(default_factory=list)  # finds not decided upon, in order; the first stands for all
    stood: dict[str, bool] = field(default_factory=dict)  # of those in line that have ended: whether they confirm it

    def may_be(self, verdict: Verdict, words: str) -> bool:
        """Whether a find on a like track is this behaviour: told in the same words, given at least its inputs."""
        return self.words == words and set(self.cause) <= set(verdict.cause)


class Behaviours:
    """All behaviours of a campaign."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._expected: deque[str] = deque()  # test cases selected, in order, not placed yet
        self._undecided: list[str] = []  # placed, in order, not decided upon
        self._known: dict[str, Behaviour] = {}

    @property
    def representatives(self) -> dict[str, str]:
        """The test cases that have confirmed a behaviour, by its fingerprint."""
        return {name: one.representative for name, one in self._known.items() if one.representative}

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

    def ended(self, trial: Trial) -> None:
        """Note that a test case has ended, and which of its violations stood: the next in line may stand for all."""
        for policy, fingerprint in trial.behaviours.items():
            behaviour = self._known[fingerprint]
            if trial.name in behaviour.line:
                behaviour.stood[trial.name] = policy in trial.stood
                self._advance(behaviour)

    def _place(self, trial: Trial) -> None:
        assert trial.judgement is not None, f"{trial.name} was not judged"
        shape = shape_of(trial.judgement.track if trial.test_case.scenario.obstacles else ())
        for verdict in violated_verdicts(trial.judgement):
            behaviour = self._behaviour(trial, verdict, shape)
            trial.behaviours[verdict.policy] = behaviour.fingerprint
            if not behaviour.representative:
                behaviour.line.append(trial.name)
        self._undecided.append(trial.name)

    def _behaviour(self, trial: Trial, verdict: Verdict, shape: Shape) -> Behaviour:
        words = verdict.behaviour or f"{verdict.policy} of {trial.name}"
        known = [one for one in self._known.values() if one.may_be(verdict, words)]
        place = first_like(shape, [one.shape for one in known])
        if place is not None:
            return known[place]
        like = sum(1 for one in self._known.values() if one.words == words)
        founded = Behaviour(short_id(f"{words}\x1f{like}".encode()), words, verdict.cause, shape)
        self._known[founded.fingerprint] = founded
        trial.founded += 1
        return founded

    def _advance(self, behaviour: Behaviour) -> None:
        """Have the first in line decide once it has ended: it has confirmed the behaviour, or the next one is asked."""
        while behaviour.line and behaviour.line[0] in behaviour.stood:
            first = behaviour.line.pop(0)
            if behaviour.stood.pop(first):
                behaviour.representative = first
                behaviour.line, behaviour.stood = [], {}
                self._core.counts.behaviours += 1
