"""The judge stage: a flight and its trace in, verdicts out. It keeps no memory, so any number may run anywhere."""

from __future__ import annotations

from saflite.contract.blobs import Blobs
from saflite.contract.flight import unpack_trace
from saflite.contract.service import Cancelled
from saflite.contract.work import JudgeResult, JudgeWork, Result, Stage, Work
from saflite.oracle.judge import judge
from saflite.oracle.policy import check_told


class Oracle:
    """One replica of the oracle, which finds traces in `blobs`."""

    stage: Stage = "judge"

    def __init__(self, blobs: Blobs) -> None:
        self._blobs = blobs

    @property
    def cursor(self) -> int:
        """Always -1: the oracle is told nothing of earlier flights."""
        return -1

    @property
    def parallel(self) -> int:
        """One flight at a time."""
        return 1

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Judge one flight; raises Refused for what is no trace or an unknown policy, BlobMissing for no trace."""
        assert isinstance(work, JudgeWork), f"the oracle was given {type(work).__name__}"
        flight = work.flight
        check_told(work.policies, work.policy_texts)
        trace = None if flight.trace is None else unpack_trace(self._blobs.get(flight.trace), flight.trace_digest)
        return JudgeResult(judgement=judge(work.test_case, flight, trace, work.policies, work.policy_texts))

    def close(self) -> None:
        """Nothing is held."""


def open_service(blobs: Blobs) -> Oracle:
    """Return the service of the judge stage."""
    return Oracle(blobs)
