"""Knows and learns which input moves what a policy watches: for parameter, command, stick, mode and fault stimuli."""

from __future__ import annotations

import math
import threading
from typing import NamedTuple

from saflite.contract.score import SCORE_MAX
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Stimulus, TestCase
from saflite.contract.work import Outcome
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.forest import danger
from saflite.scorer_pool.model import MIDDLE, Job, ModelScore, PolicyBrief, ScoreSheet, Tools
from saflite.scorer_pool.relevance.knowledge import brief_names_negative, negative, relation

TRUST = 4.0
"""Flights with an input after which what was seen weighs as much as what was known."""

RULE_INPUTS = 3
"""Different inputs that have to come together to break a rule, at most, among the bugs of the paper."""

VALUE_SHARE = 0.2
"""Share of the score that goes to negative values, where the policy's words call them interesting."""

Key = tuple[str, str]
Lessons = dict[Key, float]
"""By (kind, name): how much the input changed the danger, as a difference of log odds, shrunk towards 0."""


class Priors(dict[Key, float]):
    """How likely each input bears on any of the policies, as far as is known before any flight."""

    def __init__(self, briefs: tuple[PolicyBrief, ...]) -> None:
        super().__init__()
        self.briefs = briefs

    def __missing__(self, key: Key) -> float:
        """Work it out once."""
        self[key] = max((relation(*key, brief) for brief in self.briefs), default=0.0)
        return self[key]


class Learned(NamedTuple):
    """What is known of each input before any flight, and what the flights so far say of it."""

    priors: Priors
    lessons: Lessons

    def weight(self, key: Key) -> float:
        """Return the chance that the input matters to any of the policies, 0..1."""
        return 1.0 / (1.0 + math.exp(-(_log_odds(self.priors[key]) + 2.0 * self.lessons.get(key, 0.0))))


class Model:
    """Scores by the most relevant inputs of a test case and by how little else is in it; the middle for none."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("relevance", argument)
        self.label = "relevance"
        self._learned = Learned(Priors(()), {})
        self._moment: tuple[int, int] | None = None
        self._lock = threading.Lock()

    def score(self, job: Job) -> ScoreSheet:
        """Return one score per test case."""
        learned = self._learn(job)
        return ScoreSheet(tuple(_score_of(case, learned) for case in job.test_cases), digest="relevance-3")

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""

    def _learn(self, job: Job) -> Learned:
        moment = (job.cursor, len(job.history))
        with self._lock:
            if self._learned.priors.briefs != job.briefs:
                self._learned, self._moment = Learned(Priors(job.briefs), {}), None
            if self._moment != moment:
                self._learned, self._moment = Learned(self._learned.priors, learn(job.history)), moment
            return self._learned


def learn(history: tuple[Outcome, ...]) -> Lessons:
    """Return what the flights say of each input, given all outcomes in order.

    Only differences between inputs count, so guidance does for danger: an input that brings a rule nearer to applying
    has moved what the policy watches.
    """
    flown = [
        (outcome.test_case, outcome.guidance)
        for outcome in history
        if outcome.guidance is not None and outcome.test_case.stimuli
    ]
    if not flown:
        return {}
    dangers = danger([guidance for _, guidance in flown])
    base = float(dangers.mean())
    sums: dict[Key, tuple[float, int]] = {}
    for (test_case, _), value in zip(flown, dangers, strict=True):
        for key in {(stimulus.kind, stimulus.name) for stimulus in test_case.stimuli}:
            total, count = sums.get(key, (0.0, 0))
            sums[key] = (total + float(value), count + 1)
    return {
        key: _log_odds((total + TRUST * base) / (count + TRUST)) - _log_odds(base)
        for key, (total, count) in sums.items()
    }


def _key(stimulus: Stimulus) -> Key:
    return stimulus.kind, stimulus.name


def _score_of(test_case: TestCase, learned: Learned) -> ModelScore:
    briefs = learned.priors.briefs
    if not test_case.stimuli or not briefs:
        return ModelScore(MIDDLE, "no stimuli: relevance has nothing to say")
    weights = {key: learned.weight(key) for key in map(_key, test_case.stimuli)}
    ordered = sorted(((weight, name) for (_, name), weight in weights.items()), reverse=True)
    best = [weight for weight, _ in ordered[:RULE_INPUTS]]
    together = sum(best) / min(RULE_INPUTS, len(test_case.stimuli))
    whole = sum(weights[_key(one)] for one in test_case.stimuli) / len(test_case.stimuli)
    strongest = ", ".join(f"{name} ({weight:.2f})" for weight, name in ordered[:RULE_INPUTS])
    share = (together + whole) / 2.0
    if any(brief_names_negative(brief) for brief in briefs):
        named = [weights[_key(one)] for one in test_case.stimuli if negative(one)]
        share += VALUE_SHARE * (max(named, default=0.0) - share)
    return ModelScore(SCORE_MAX * share, f"most relevant: {strongest}")


def _log_odds(share: float) -> float:
    kept = min(1.0 - 1e-6, max(1e-6, share))
    return math.log(kept / (1.0 - kept))
