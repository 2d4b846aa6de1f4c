"""The fly stage: a lease in, a flight out."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from saflite.contract.blobs import Blobs
from saflite.contract.clock import Clock
from saflite.contract.config import environment
from saflite.contract.errors import Refused
from saflite.contract.flight import Artefact, Flight
from saflite.contract.modules import given
from saflite.contract.service import Cancelled
from saflite.contract.test_case import cut_off, identity, under_noise
from saflite.contract.work import FlyResult, FlyWork, Result, Stage, Work
from saflite.simulator_worker.messages import FlightReply
from saflite.simulator_worker.sandbox import SNAPSHOTS_MAX, Sandbox, SandboxConfig

log = logging.getLogger(__name__)

DIGITS_MAX = 9
SHARING = frozenset({"search", "shrink"})
"""Purposes whose flights may begin from a snapshot; any other is a flight of its own from the start."""


class Flyer:
    """A simulator worker: one sandbox, one flight at a time."""

    stage: Stage = "fly"
    cursor = -1
    parallel = 1

    def __init__(self, worker: str, clock: Clock, blobs: Blobs, config: SandboxConfig) -> None:
        self._worker, self._clock, self._blobs = worker, clock, blobs
        self._sandbox = Sandbox(clock, config)

    def builds(self) -> dict[str, str]:
        """Return the targets that can fly here, each with its build; raises Unavailable if no simulator comes up."""
        return self._sandbox.builds()

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Fly the test case of the lease once.

        Raises:
            Refused: the target cannot fly it, or does not do what it says of itself.
            Unavailable: the flight was cancelled, or what it left behind cannot be put anywhere.
        """
        assert isinstance(work, FlyWork), f"a simulator worker was given {type(work).__name__}"
        started_s = self._clock.monotonic_s()
        flown = cut_off(under_noise(work.test_case, work.noise), work.until_s)
        reply = self._sandbox.fly(flown, work.wall_limit_s, cancelled, share=work.purpose in SHARING)
        if reply.ending in ("lost", "wedged", "infra"):
            log.warning("flight of %s: %s, %s", identity(work.test_case), reply.ending, reply.message)
        return self._result(work, reply, self._clock.monotonic_s() - started_s)

    def _result(self, work: FlyWork, reply: FlightReply, wall_s: float) -> FlyResult:
        flight = Flight(
            test_case=identity(work.test_case),
            flight_index=work.flight_index,
            ending=reply.ending,
            simulated_s=reply.simulated_s,
            wall_s=round(wall_s, 4),
            trace_digest=reply.trace_digest,
            trace=self._blobs.put(reply.trace) if reply.trace else None,
            worker=self._worker,
            message=reply.message,
            build=reply.build,
            delivered=reply.delivered,
            artefacts=tuple(Artefact(name=name, blob=self._blobs.put(data)) for name, data in reply.artefacts.items()),
        )
        return FlyResult(flight=flight)

    def close(self) -> None:
        """End the simulator process."""
        self._sandbox.close()


def open_service(
    worker: str, clock: Clock, blobs: Blobs, target_files: Sequence[Path] = (), *, verify: bool = False
) -> Flyer:
    """Return a simulator worker called `worker` that leaves what flights leave behind in `blobs`.

    `target_files` are target modules from outside the package, besides those the process was given; `verify` has
    the first flight of each target flown twice where the target says that its flights repeat bit by bit. Raises
    Refused for a `SAFLITE_SNAPSHOTS_MAX` that is no number.
    """
    files = (*target_files, *(module.path for module in given("target").values()))
    return Flyer(worker, clock, blobs, SandboxConfig(files, snapshots_max(), verify))


def snapshots_max() -> int:
    """Return how many snapshots a simulator may hold: `SAFLITE_SNAPSHOTS_MAX`, 0 switches them off."""
    text = environment("SAFLITE_SNAPSHOTS_MAX", str(SNAPSHOTS_MAX))
    if not text.isdecimal() or len(text) > DIGITS_MAX:
        raise Refused("SAFLITE_SNAPSHOTS_MAX", expected="a whole number, 0 to hold no snapshots", got=repr(text[:80]))
    return int(text)
