"""A score drawn at random per test case: chance, the second baseline. The draw depends on test case and seed only."""

from __future__ import annotations

from saflite.contract.rng import derive
from saflite.contract.score import SCORE_MAX, SCORE_MIN
from saflite.contract.service import Cancelled
from saflite.contract.test_case import draw_key
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.model import Job, ModelScore, ScoreSheet, Tools


class Model:
    """Draws uniformly from 0 to 10."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("random", argument)
        self.label = "random"

    def score(self, job: Job) -> ScoreSheet:
        """Return one draw per test case."""
        draws = (derive(job.rng_seed, "score", "random", draw_key(case)) for case in job.test_cases)
        values = (float(rng.uniform(SCORE_MIN, SCORE_MAX)) for rng in draws)
        return ScoreSheet(tuple(ModelScore(value, "drawn at random") for value in values), digest="random-1")

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""
