"""Geometry alone: narrow passages between boxes near the way of the mission score high."""

from __future__ import annotations

from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.scorer_pool.geometry_score import look
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.features import has_layout
from saflite.scorer_pool.model import MIDDLE, Job, ModelScore, ScoreSheet, Tools


class Model:
    """Scores layouts by their narrowest passage; has nothing to say about test cases without obstacles."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("gap", argument)
        self.label = "gap"

    def score(self, job: Job) -> ScoreSheet:
        """Return one score per test case."""
        return ScoreSheet(tuple(_mark(case) for case in job.test_cases), digest="gap-1")

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""


def _mark(test_case: TestCase) -> ModelScore:
    if not has_layout(test_case):
        return ModelScore(MIDDLE, "no mission among obstacles: geometry has nothing to say")
    seen = look(test_case.scenario)
    return ModelScore(seen.score, f"narrowest passage {seen.gap_m:.1f} m, straight way {seen.path_m:.1f} m from a box")
