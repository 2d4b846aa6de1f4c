"""A test case is the more interesting the more is done in it: a scorer to begin with.

saflite conformance scorer NAME --module NAME.py
saflite run avoidance-m2 --scorer NAME --module NAME.py
"""

from __future__ import annotations

from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.model import Job, ModelScore, ScoreSheet, Tools

LABEL = "NAME"
DIGEST = "NAME-1"  # change it when scores change


class Model:
    """Scores 0 (dull) to 10 (interesting) by what stands in the job only: no memory, no clock, no randomness."""

    parallel = 1  # more for one that waits for a server

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument(LABEL, argument)  # what stands behind the colon in `--scorer NAME:argument`
        self.label = LABEL

    def score(self, job: Job) -> ScoreSheet:
        """Return one score for each test case; `job.history` tells what became of those flown."""
        return ScoreSheet(tuple(_scored(one) for one in job.test_cases), digest=DIGEST)

    def warm(self, cancelled: Cancelled) -> str:
        """Load what is needed."""
        return "ready"

    def close(self) -> None:
        """Free it."""


def _scored(test_case: TestCase) -> ModelScore:
    things = len(test_case.stimuli) + len(test_case.scenario.obstacles)
    value = 10.0 * things / (things + 2.0)
    return ModelScore(value, f"{things} inputs and obstacles")
