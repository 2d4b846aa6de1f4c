"""Learns from the flights of this campaign: extremely randomised trees on what the test cases look like.

Until 16 flights are known `gap` answers: the same score for all would leave the choice to novelty, worse than chance.
"""

from __future__ import annotations

import threading
from collections import OrderedDict

from saflite.contract.score import SCORE_MAX
from saflite.contract.service import Cancelled
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.forest import FLIGHTS_MIN, Forest, grow, step_size, telling
from saflite.scorer_pool.learning.vectors import Vectors
from saflite.scorer_pool.model import Job, ModelScore, ScoreSheet, Tools

FORESTS_KEPT = 4


class Model:
    """Scores by the danger its forest expects; by geometry while too little was flown."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("surrogate", argument)
        self.label = "surrogate"
        self._unlearned = tools.model("gap")
        self._vectors = Vectors()
        self._forests: OrderedDict[tuple[int, int], Forest] = OrderedDict()
        self._lock = threading.Lock()

    def forest(self, job: Job) -> Forest | None:
        """Return the forest for the job's history, None while fewer than 16 flights are known."""
        known = telling(job.history)
        if len(known) < FLIGHTS_MIN:
            return None
        size = step_size(len(known))
        key = (known[0].round, size)  # of a long campaign the earliest rounds are left out in time
        with self._lock:
            if key not in self._forests:
                self._forests[key] = grow(known[:size], self._vectors)
                while len(self._forests) > FORESTS_KEPT:
                    self._forests.popitem(last=False)
            return self._forests[key]

    def score(self, job: Job) -> ScoreSheet:
        """Return ten times the expected danger per test case."""
        forest = self.forest(job)
        if forest is None:
            seen = self._unlearned.score(job)
            reason = f"fewer than {FLIGHTS_MIN} flights to learn from; gap"
            scores = tuple(score._replace(reason=f"{reason}: {score.reason}") for score in seen.scores)
            return ScoreSheet(scores, digest=f"surrogate-3+{seen.digest}")
        expected = forest.predict(self._vectors.of(list(job.test_cases)))
        reason = f"learned from {forest.flights} flights"
        return ScoreSheet(
            tuple(ModelScore(SCORE_MAX * float(min(1.0, max(0.0, value))), reason) for value in expected),
            digest=f"surrogate-3-{forest.flights}",
        )

    def warm(self, cancelled: Cancelled) -> str:
        """Load the library the trees come from."""
        import sklearn.ensemble

        return f"ready, {sklearn.ensemble.ExtraTreesRegressor.__name__}"

    def close(self) -> None:
        """Nothing to free: the pool closes `gap`."""
