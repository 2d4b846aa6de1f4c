"""The fly stage: a lease in, a flight out."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from saflite.contract.clock import Clock
from saflite.contract.flight import Flight
from saflite.contract.service import Cancelled
from saflite.contract.test_case import identity
from saflite.contract.work import FlyResult, FlyWork, Result, Stage, Work
from saflite.simulator_worker.sandbox import Sandbox

log = logging.getLogger(__name__)


class Flyer:
    """A simulator worker: one sandbox, one flight at a time."""

    stage: Stage = "fly"
    cursor = -1
    parallel = 1

    def __init__(self, worker: str, clock: Clock, target_files: Sequence[Path] = ()) -> None:
        self._worker, self._clock = worker, clock
        self._sandbox = Sandbox(clock, target_files)

    def targets(self) -> tuple[str, ...]:
        """Return the targets that can fly here; raises Unavailable if the simulator does not come up."""
        return self._sandbox.targets()

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Fly the test case of the lease once.

        Raises:
            Refused: the target cannot fly it.
            Unavailable: the flight was cancelled.
        """
        assert isinstance(work, FlyWork), f"a simulator worker was given {type(work).__name__}"
        started_s = self._clock.monotonic_s()
        reply = self._sandbox.fly(work.test_case, work.wall_limit_s, cancelled)
        if reply.ending in ("lost", "wedged", "infra"):
            log.warning("flight of %s: %s, %s", identity(work.test_case), reply.ending, reply.message)
        flight = Flight(
            test_case=identity(work.test_case),
            flight_index=work.flight_index,
            ending=reply.ending,
            simulated_s=reply.simulated_s,
            wall_s=round(self._clock.monotonic_s() - started_s, 4),
            trace_digest=reply.trace_digest,
            worker=self._worker,
            message=reply.message,
        )
        return FlyResult(flight=flight, trace=reply.trace)

    def close(self) -> None:
        """End the simulator process."""
        self._sandbox.close()


def open_service(worker: str, clock: Clock, target_files: Sequence[Path] = ()) -> Flyer:
    """Return a simulator worker called `worker`; `target_files` are target modules from outside the package."""
    return Flyer(worker, clock, target_files)
