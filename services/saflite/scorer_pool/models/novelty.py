"""How unlike anything flown before a test case is: its distance to the nearest flown one, as selection measures it."""

from __future__ import annotations

from saflite.contract.score import SCORE_MAX
from saflite.contract.service import Cancelled
from saflite.flight.novelty import Features, features, nearest
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.vectors import Memo
from saflite.scorer_pool.model import MIDDLE, Job, ModelScore, ScoreSheet, Tools

DIGEST = "novelty-2"


class Model:
    """Scores by distance to the nearest flown test case."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("novelty", argument)
        self.label = "novelty"
        self._features: Memo[Features] = Memo(lambda cases: map(features, cases))

    def score(self, job: Job) -> ScoreSheet:
        """Return 0 for what was flown already, towards 10 for what is unlike all; the middle before any flight."""
        if not job.history:
            return ScoreSheet(tuple(ModelScore(MIDDLE, "nothing flown yet") for _ in job.test_cases), digest=DIGEST)
        flown = self._features.of([outcome.test_case for outcome in job.history])
        far = nearest(self._features.of(job.test_cases), flown)
        scores = tuple(
            ModelScore(SCORE_MAX * float(one), f"distance to the nearest flown case {one:.2f} of 1") for one in far
        )
        return ScoreSheet(scores, digest=DIGEST)

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""
