"""The whole pipeline in one process and one thread: real books and store, real services, no bus; for measurements.

Flights of the reference target are deterministic, so one flown before (by another scorer model, from the same seed) is
taken from memory instead of being flown again: the counts are the same, the wait is not.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import msgspec

from saflite.campaign.engine.state import Books
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.conformance.flying import fly_once
from saflite.contract.blobs import Blobs
from saflite.contract.config import Campaign
from saflite.contract.control import Status
from saflite.contract.errors import Unavailable
from saflite.contract.flight import Flight, pack_trace, trace_digest
from saflite.contract.join import Join
from saflite.contract.service import Cancelled, Service
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import identity, told_in_order, under_noise
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import (
    Ask,
    Failure,
    FlyResult,
    FlyWork,
    Report,
    Result,
    Stage,
    WarmResult,
    WarmWork,
    Work,
)
from saflite.evidence.memory import MemoryBlobs
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator import work as mutator
from saflite.oracle import work as oracle
from saflite.runtime.clock import WallClock
from saflite.runtime.stages import brief_of
from saflite.scorer_pool import work as scorer_pool
from saflite.scorer_pool.model import BriefOf

CAST: tuple[tuple[Stage, int], ...] = (("mutate", 1), ("score", 1), ("fly", 1), ("judge", 1), ("fly", 2), ("judge", 1))
"""Who asks in turn. Two take turns flying: a confirmation waits for a worker other than the finder, and were the second
one asked only when nothing else is left, counts up to a *confirmed* find would tell the order of the models."""


class Flights:
    """Flies on the reference target, or remembers."""

    stage: Stage = "fly"
    cursor = -1
    parallel = 1

    def __init__(self) -> None:
        self.blobs: Blobs = MemoryBlobs()  # those of the campaign at hand
        self._kept: dict[tuple[str, int], tuple[Flight, bytes]] = {}
        self.flown = 0

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Fly the test case of the lease, or hand out what it did the last time."""
        assert isinstance(work, FlyWork)
        name = identity(work.test_case)
        if (name, work.noise) not in self._kept:
            self._kept[name, work.noise] = self._fly(work, cancelled)
        flight, packed = self._kept[name, work.noise]
        trace = self.blobs.put(packed) if packed else None
        record = msgspec.structs.replace(flight, test_case=name, flight_index=work.flight_index, trace=trace)
        return FlyResult(flight=record)

    def _fly(self, work: FlyWork, cancelled: Cancelled) -> tuple[Flight, bytes]:
        self.flown += 1
        landed = fly_once(under_noise(work.test_case, work.noise), cancelled)
        if landed.trace is None:  # tried again by the books, then set aside and counted, as in a farm
            sys.stderr.write(f"{landed.ending}: {landed.message}: {told_in_order(work.test_case.stimuli)}\n")
            return Flight(test_case="", flight_index=0, ending=landed.ending, worker="inline"), b""
        flight = Flight(
            test_case="",
            flight_index=0,
            ending=landed.ending,
            simulated_s=landed.trace.duration_s,
            trace_digest=trace_digest(landed.trace),
            worker="inline",
            delivered=landed.delivered,
        )
        return flight, pack_trace(landed.trace)

    def close(self) -> None:
        """Nothing is held."""


class Inline:
    """A campaign from its first round to `run`'s end. Services may be shared by several campaigns."""

    def __init__(
        self,
        campaign: Campaign,
        run_dir: Path,
        flights: Flights,
        target: TargetInfo | None = None,
        brief: BriefOf = brief_of,
    ) -> None:
        """Begin; on the reference target, with scorers told all of the policies, if not said otherwise."""
        self._store = Store.create(run_dir, campaign, template(campaign), target or describe())
        self._books: Books = self._store.rebuild()
        flights.blobs = self._store.blobs
        self._clock = WallClock()
        self._services: dict[Stage, Service] = {
            "mutate": mutator.open_service(),
            "score": scorer_pool.open_service(brief, self._clock),
            "fly": flights,
            "judge": oracle.open_service(self._store.blobs),
        }
        self._watch: dict[Stage, Callable[[Result], None]] = {}
        self._books.begin(self._clock.monotonic_s(), self._clock.unix_s())

    def warm(self, model: str) -> None:
        """Have a scorer model ready before the first round: no embedded scorer answers while it loads.

        Raises:
            Unavailable: it cannot be had.
        """
        warmed = self._services["score"].do(WarmWork(model=model), lambda: False)
        assert isinstance(warmed, WarmResult), warmed
        if not warmed.ready:
            raise Unavailable(f"{model}: {warmed.message}")

    def watch(self, stage: Stage, saw: Callable[[Result], None]) -> None:
        """Show every result of a stage to `saw`."""
        self._watch[stage] = saw

    def run(self, enough: Callable[[Status], bool]) -> Status:
        """Work until `enough` says so or the campaign ends; returns the last status."""
        while True:
            steps = [self._step(stage, number) for stage, number in CAST]
            busy = any(steps)
            status = self._books.status(self._clock.monotonic_s())
            if enough(status) or self._books.ended or not busy:
                return status

    def close(self) -> None:
        """Close services and store."""
        for service in self._services.values():
            service.close()
        self._store.close()

    def _step(self, stage: Stage, number: int) -> bool:
        service, now_s = self._services[stage], self._clock.monotonic_s()
        ask = Ask(worker=f"{stage}-{number}", stage=stage, leases_max=1, cursor=service.cursor)
        self._books.join(Join(protocol=PROTOCOL, worker=ask.worker, stage=stage), now_s)
        grant = self._books.ask(ask, now_s)
        self._store.commit(self._books.drain())
        for lease in grant.leases:
            result = service.do(lease.work, lambda: False)
            assert not isinstance(result, Failure), result
            if stage in self._watch:
                self._watch[stage](result)
            report = Report(worker=ask.worker, lease_id=lease.lease_id, epoch=lease.epoch, result=result)
            receipt = self._books.report(report, self._clock.monotonic_s())
            assert receipt.status == "accepted", receipt
            self._store.commit(self._books.drain())
        return bool(grant.leases)
