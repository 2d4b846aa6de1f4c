"""The judge stage: a flight and its trace in, verdicts out. It keeps no memory, so any number may run anywhere."""

from __future__ import annotations

from saflite.contract.flight import unpack_trace
from saflite.contract.service import Cancelled
from saflite.contract.work import JudgeResult, JudgeWork, Result, Stage, Work
from saflite.oracle.judge import judge


class Oracle:
    """One replica of the oracle."""

    stage: Stage = "judge"

    @property
    def cursor(self) -> int:
        """Always -1: the oracle is told nothing of earlier flights."""
        return -1

    @property
    def parallel(self) -> int:
        """One flight at a time."""
        return 1

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Judge one flight; raises Refused for a damaged trace or an unknown policy."""
        assert isinstance(work, JudgeWork), f"the oracle was given {type(work).__name__}"
        trace = unpack_trace(work.trace) if work.trace else None
        return JudgeResult(judgement=judge(work.test_case, work.flight, trace, work.policies, work.policy_texts))

    def close(self) -> None:
        """Nothing is held."""


def open_service() -> Oracle:
    """Return the service of the judge stage."""
    return Oracle()
