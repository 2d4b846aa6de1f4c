"""How unlike anything flown before a test case is: distance in feature space to the nearest flown one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saflite.contract.score import SCORE_MAX
from saflite.contract.service import Cancelled
from saflite.contract.test_case import identity
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.vectors import Vectors
from saflite.scorer_pool.model import MIDDLE, Job, ModelScore, ScoreSheet, Tools

HALF_WAY = 1.0
"""Distance (in standard deviations per feature, root mean square) at which a test case scores 5."""


class Model:
    """Scores by distance to the nearest flown test case."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("novelty", argument)
        self.label = "novelty"
        self._vectors = Vectors()

    def score(self, job: Job) -> ScoreSheet:
        """Return 0 for what was flown already, towards 10 for what is unlike all; the middle before any flight."""
        if not job.history:
            return ScoreSheet(
                tuple(ModelScore(MIDDLE, "nothing flown yet") for _ in job.test_cases), digest="novelty-1"
            )
        flown = self._vectors.of([outcome.test_case for outcome in job.history])
        known = {identity(outcome.test_case) for outcome in job.history}
        asked = self._vectors.of(list(job.test_cases))
        scores = []
        for case, distance in zip(job.test_cases, _nearest(asked, flown), strict=True):
            far = 0.0 if identity(case) in known else float(distance)
            scores.append(ModelScore(SCORE_MAX * far / (far + HALF_WAY), f"nearest flown case is {far:.2f} sd away"))
        return ScoreSheet(tuple(scores), digest="novelty-1")

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""


def _nearest(asked: NDArray[np.float64], flown: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return for each row of `asked` the root-mean-square distance to the nearest row of `flown`, in flown sd."""
    spread = flown.std(axis=0)
    varying = spread > 1e-9
    scale = np.where(varying, spread, 1.0)
    scaled = flown / scale
    count = max(1, int(varying.sum()))
    near = [((scaled - row / scale) ** 2).sum(axis=1).min() for row in asked]
    return np.sqrt(np.array(near) / count)
