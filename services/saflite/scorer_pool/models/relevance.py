"""Knows and learns which input moves what a policy watches: for parameter, command, stick, mode and fault stimuli."""

from __future__ import annotations

import math
import threading
from collections import Counter
from typing import NamedTuple

from saflite.contract.score import SCORE_MAX
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.contract.work import Outcome
from saflite.scorer_pool.knowledge import brief_names_negative, negative, relation
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning import danger, telling
from saflite.scorer_pool.model import MIDDLE, Job, Mark, PolicyBrief, Sheet, Tools

TRUST = 4.0
"""Flights with an input after which what was seen weighs as much as what was known."""

RULE_INPUTS = 3
"""Different inputs that have to come together to break a rule, at most, among the bugs of the paper."""

VALUE_SHARE = 0.2
"""Share of the score that goes to negative values, where the policy's words call them interesting."""

PATIENCE = 8.0
"""Flights with the same telling inputs after which trying them again counts less: the score of what was tried often
in vain falls with the root of the number of tries, so that it makes way for the next best."""

Key = tuple[str, str]
Lessons = dict[Key, float]
"""By (kind, name): how much the input changed the danger, as a difference of log odds, shrunk towards 0."""


class Learned(NamedTuple):
    """What the flights so far say of each input, and how many had the same most relevant inputs."""

    lessons: Lessons
    flown: Counter[frozenset[Key]]


class Model:
    """Scores by the most relevant inputs of a test case and by how little else is in it; the middle for none."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("relevance", argument)
        self.label = "relevance"
        self._learned: tuple[tuple[int, int, tuple[PolicyBrief, ...]], Learned] | None = None
        self._lock = threading.Lock()

    def score(self, job: Job) -> Sheet:
        """Return one mark per test case."""
        learned = self._told_by(job)
        return Sheet(tuple(_mark(case, job.briefs, learned) for case in job.test_cases), digest="relevance-3")

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""

    def _told_by(self, job: Job) -> Learned:
        key = (job.cursor, len(job.history), job.briefs)
        with self._lock:
            if self._learned is None or self._learned[0] != key:
                flown = Counter(_telling_inputs(outcome.test_case, job.briefs) for outcome in job.history)
                self._learned = (key, Learned(learn(job.history), flown))
            return self._learned[1]


def learn(history: tuple[Outcome, ...]) -> Lessons:
    """Return what the flights say of each input, given all outcomes in order."""
    flown = [outcome for outcome in telling(history) if outcome.test_case.stimuli]
    if not flown:
        return {}
    dangers = danger(flown)
    base = float(dangers.mean())
    sums: dict[Key, tuple[float, int]] = {}
    for outcome, value in zip(flown, dangers, strict=True):
        for key in {(stimulus.kind, stimulus.name) for stimulus in outcome.test_case.stimuli}:
            total, count = sums.get(key, (0.0, 0))
            sums[key] = (total + float(value), count + 1)
    return {
        key: _log_odds((total + TRUST * base) / (count + TRUST)) - _log_odds(base)
        for key, (total, count) in sums.items()
    }


def _telling_inputs(test_case: TestCase, briefs: tuple[PolicyBrief, ...]) -> frozenset[Key]:
    """Return the inputs that most likely bear on the policies, as far as is known before any flight."""
    keys = {(one.kind, one.name) for one in test_case.stimuli}
    priors = sorted((-_prior(key, briefs), key) for key in keys)
    return frozenset(key for _, key in priors[:RULE_INPUTS])


def _mark(test_case: TestCase, briefs: tuple[PolicyBrief, ...], learned: Learned) -> Mark:
    if not test_case.stimuli or not briefs:
        return Mark(MIDDLE, "no stimuli: relevance has nothing to say")
    weights = {
        (one.kind, one.name): _weight((one.kind, one.name), briefs, learned.lessons) for one in test_case.stimuli
    }
    ordered = sorted(((weight, name) for (_, name), weight in weights.items()), reverse=True)
    best = [weight for weight, _ in ordered[:RULE_INPUTS]]
    together = sum(best) / min(RULE_INPUTS, len(test_case.stimuli))
    whole = sum(weights[one.kind, one.name] for one in test_case.stimuli) / len(test_case.stimuli)
    told = ", ".join(f"{name} ({weight:.2f})" for weight, name in ordered[:RULE_INPUTS])
    share = (together + whole) / 2.0
    if any(brief_names_negative(brief) for brief in briefs):
        named = [weights[one.kind, one.name] for one in test_case.stimuli if negative(one)]
        share += VALUE_SHARE * (max(named, default=0.0) - share)
    tried = learned.flown[_telling_inputs(test_case, briefs)]
    share /= math.sqrt(1.0 + tried / PATIENCE)
    return Mark(SCORE_MAX * share, f"most relevant: {told}; {tried} flights with these before")


def _prior(key: Key, briefs: tuple[PolicyBrief, ...]) -> float:
    return max(relation(*key, brief) for brief in briefs)


def _weight(key: Key, briefs: tuple[PolicyBrief, ...], lessons: Lessons) -> float:
    """Return the chance that the input matters to any of the policies, 0..1."""
    return 1.0 / (1.0 + math.exp(-(_log_odds(_prior(key, briefs)) + 2.0 * lessons.get(key, 0.0))))


def _log_odds(share: float) -> float:
    kept = min(1.0 - 1e-6, max(1e-6, share))
    return math.log(kept / (1.0 - kept))
