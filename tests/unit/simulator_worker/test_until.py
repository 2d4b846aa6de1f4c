"""A flight asked for until some moment is the beginning of the whole one, bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.flight import Trace, unpack_trace
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.work import FlyResult, FlyWork
from saflite.evidence.memory import MemoryBlobs
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.work import open_service

LATE = Stimulus(at_s=9.0, kind="mode", name="LAND")
CASE = TestCase(
    target=Target(),
    scenario=Scenario(start=StartState(mode="LOITER", altitude_m=20.0), time_limit_s=12.0),
    stimuli=(Stimulus(at_s=2.0, kind="stick", name="RC2", values=(1200.0,)), LATE),
)


def _flown(until_s: float | None, noise: int) -> tuple[FlyResult, Trace]:
    blobs = MemoryBlobs()
    flyer = open_service("fly-1", WallClock(), blobs)
    work = FlyWork(test_case=CASE, flight_index=1, purpose="confirm", wall_limit_s=60.0, noise=noise, until_s=until_s)
    try:
        result = flyer.do(work, lambda: False)
    finally:
        flyer.close()
    assert isinstance(result, FlyResult)
    assert result.flight.trace is not None
    return result, unpack_trace(blobs.get(result.flight.trace))


@pytest.mark.parametrize("noise", [0, 1])
def test_it_is_the_beginning_of_the_whole_flight(noise: int) -> None:
    (part, short), (whole, long) = _flown(5.0, noise), _flown(None, noise)
    assert part.flight.test_case == whole.flight.test_case, "of the same test case, whatever part is flown"
    assert short.duration_s == pytest.approx(5.0, abs=0.1)
    assert long.duration_s == pytest.approx(12.0, abs=0.1)
    for name in long.signals:
        assert np.array_equal(short.array(name), long.array(name)[: short.samples], equal_nan=True), name
    assert part.flight.delivered is not None
    assert whole.flight.delivered is not None
    assert part.flight.delivered == whole.flight.delivered[:1], "what is due later is not given"


def test_a_moment_after_the_end_changes_nothing() -> None:
    assert _flown(99.0, 1)[0].flight.trace_digest == _flown(None, 1)[0].flight.trace_digest
