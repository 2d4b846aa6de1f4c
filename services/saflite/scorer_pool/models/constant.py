"""The same score for every test case (`constant`, `constant:7`): the baseline every other model must beat."""

from __future__ import annotations

from saflite.contract.errors import Refused
from saflite.contract.score import SCORE_MAX, SCORE_MIN
from saflite.contract.service import Cancelled
from saflite.scorer_pool.model import MIDDLE, Job, ModelScore, ScoreSheet, Tools


class Model:
    """Gives `argument` (5 if none) to all."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        self.label = f"constant:{argument}" if argument else "constant"
        self._value = _number(argument) if argument else MIDDLE

    def score(self, job: Job) -> ScoreSheet:
        """Return the constant for each test case."""
        return ScoreSheet(tuple(ModelScore(self._value, "constant") for _ in job.test_cases), digest=self.label)

    def warm(self, cancelled: Cancelled) -> str:
        """Nothing to load."""
        return "ready"

    def close(self) -> None:
        """Nothing to free."""


def _number(argument: str) -> float:
    try:
        value = float(argument)
    except ValueError:
        value = float("nan")
    if not SCORE_MIN <= value <= SCORE_MAX:
        raise Refused("scorer model 'constant'", expected="a score from 0 to 10 after the colon", got=repr(argument))
    return value
