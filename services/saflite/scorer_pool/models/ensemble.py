"""A prior that knows (`blend`, or `ensemble:<model>`) and a posterior that learns (`surrogate`), weighed by skill.

The posterior's weight is earned: its ROC area on flights left out of its trees, times how much was flown.
"""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.contract.score import SCORE_MAX, SCORE_MIN
from saflite.contract.service import Cancelled
from saflite.scorer_pool.labels import split_label
from saflite.scorer_pool.learning.forest import Forest
from saflite.scorer_pool.model import Job, ModelScore, ScoreSheet, Tools
from saflite.scorer_pool.models.surrogate import Model as Surrogate

FLIGHTS_HALF = 60
"""Number of flights at which a perfectly skilled posterior weighs as much as the prior."""


class Model:
    """Mixes prior and posterior per batch."""

    def __init__(self, argument: str, tools: Tools) -> None:
        if split_label(argument)[0] == "ensemble":
            raise Refused("scorer model", expected="a prior that is no ensemble", got=f"'ensemble:{argument}'")
        self.label = f"ensemble:{argument}" if argument else "ensemble"
        self._prior = tools.model(argument or "blend")
        self._posterior = Surrogate("", tools)

    @property
    def parallel(self) -> int:
        """As many as the prior."""
        return self._prior.parallel

    def score(self, job: Job) -> ScoreSheet:
        """Return the weighed mean; a fault of the prior stays a fault."""
        prior = self._prior.score(job)
        forest = self._posterior.forest(job)
        weight = _weight(forest)
        if weight == 0.0:
            return prior
        learned = self._posterior.score(job)
        scores = tuple(_mixed(score, other, weight) for score, other in zip(prior.scores, learned.scores, strict=True))
        return ScoreSheet(scores, prior.usage, f"{prior.digest}+{learned.digest}")

    def warm(self, cancelled: Cancelled) -> str:
        """Warm both."""
        self._posterior.warm(cancelled)
        return self._prior.warm(cancelled)

    def close(self) -> None:
        """Nothing to free: the pool closes the prior."""


def _weight(forest: Forest | None) -> float:
    """Return the weight of the posterior, 0..1: nothing without flights or with no more skill than chance."""
    if forest is None or forest.skill is None:
        return 0.0
    skill = max(0.0, 2.0 * forest.skill - 1.0)
    return skill * forest.flights / (forest.flights + FLIGHTS_HALF)


def _mixed(prior: ModelScore, learned: ModelScore, weight: float) -> ModelScore:
    if prior.fault:
        return prior
    value = (1.0 - weight) * prior.value + weight * learned.value
    reason = f"prior {prior.value:.1f}, learned {learned.value:.1f} (weight {weight:.2f}); {prior.reason}"
    return prior._replace(value=min(SCORE_MAX, max(SCORE_MIN, value)), reason=reason)
