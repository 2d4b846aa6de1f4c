"""Betaflight targets: one per build of the firmware; flights are forked from start states that are kept warm."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec

from saflite.contract.clock import Clock
from saflite.contract.errors import Unavailable
from saflite.contract.flight import Flight, FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.standalone import Evidence, Files
from saflite.contract.target import Slot, Snapshot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.betaflight import user_memory
from saflite.flight.autopilots.betaflight.check import check_test_case
from saflite.flight.autopilots.betaflight.configuration import Memory, configure
from saflite.flight.autopilots.betaflight.describe import describe, missing
from saflite.flight.autopilots.betaflight.firmware import VARIANTS, Variant
from saflite.flight.autopilots.betaflight.flight import BetaflightFlight
from saflite.flight.autopilots.betaflight.inputs import Configured, configured
from saflite.flight.autopilots.betaflight.process import FirmwareDied
from saflite.flight.autopilots.betaflight.standalone.export import standalone
from saflite.simulator_worker.forks import Forks

WARM_STARTS_MAX, CONFIGURATIONS_MAX = 4, 64
PLAIN_DEADLINE_S = 30.0


class BetaflightTarget(NamedTuple):
    """What a target module offers, for one build of the firmware."""

    name: str
    variant: Variant

    def describe(self) -> TargetInfo:
        """Say what the target is and can do; raises Unavailable where the native library was not built."""
        return describe(self.name, self.variant)

    def check(self, test_case: TestCase) -> None:
        """Raise Refused where this target cannot fly the test case, Unavailable where it is not built."""
        self._be_there()
        check_test_case(test_case, self.name, self.variant)

    def open(self, slot: Slot) -> BetaflightSession:
        """Return a session; raises Unavailable where this machine lacks something."""
        self._be_there()
        return BetaflightSession(self, slot.folder, slot.clock)

    def standalone(self, test_case: TestCase, flight: Flight, evidence: Evidence) -> Files:
        """Return a script that reproduces a finding without the farm; raises as `contract/standalone.py` says."""
        self.check(test_case)
        return {evidence.file: standalone(test_case, flight, evidence, self.variant)}

    def _be_there(self) -> None:
        lacking = missing(self.variant)
        if lacking:
            raise Unavailable(f"target {self.name}: {lacking}")


def target(name: str, variant: str) -> BetaflightTarget:
    """Return the target of a build by name."""
    return BetaflightTarget(name, VARIANTS[variant])


class BetaflightSession:
    """Keeps a few start states warm and forks each flight from one; holds snapshots as forks, too."""

    def __init__(self, target: BetaflightTarget, folder: Path, clock: Clock) -> None:
        self._target, self._folder, self._clock = target, folder, clock
        self._forks = Forks(self._begin)
        self._starts: OrderedDict[bytes, Snapshot] = OrderedDict()
        self._plain: BetaflightSession | None = None
        self._configurations: OrderedDict[bytes, Memory] = OrderedDict()

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once, from a warm start state if there is one; `wedged` where `deadline_s` is not enough.

        Raises:
            Refused: this target cannot fly the test case.
            Unavailable: JSBSim or the firmware does not come up, or the flight was cancelled.
        """
        return self._flown(test_case, deadline_s, cancelled, self._warm_start)

    def fly_cold(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once from power-up, without any fork; the outcome is that of `fly`."""
        return self._flown(test_case, deadline_s, cancelled, lambda case, stop: None)

    def snapshot(self, test_case: TestCase, at_s: float, deadline_s: float, cancelled: Cancelled) -> Snapshot:
        """Fly up to `at_s` and hold; raises Unavailable where the flight ends before, is late or cancelled."""
        moved = self._ready(test_case).test_case
        late_s = self._clock.monotonic_s() + deadline_s
        return self._forks.hold(moved, at_s, lambda: cancelled() or self._clock.monotonic_s() >= late_s)

    def fly_from(
        self, snapshot: Snapshot, test_case: TestCase, deadline_s: float, cancelled: Cancelled
    ) -> FlightRecord:
        """Fly on from the snapshot, or from a start state where that cannot be; the outcome is the same. See `fly`."""
        return self._flown(
            test_case,
            deadline_s,
            cancelled,
            lambda case, stop: self._forks.fly_from(snapshot, case, stop) or self._warm_start(case, stop),
        )

    def drop(self, snapshot: Snapshot) -> None:
        """Let go of a snapshot, and of those held on from it."""
        self._forks.drop(snapshot)

    def close(self) -> None:
        """End the processes that hold start states and snapshots."""
        self._forks.close()
        self._starts.clear()
        if self._plain is not None:
            self._plain.close()

    # -- start states -------------------------------------------------------------------------------------------------

    def _ready(self, test_case: TestCase) -> Configured:
        check_test_case(test_case, self._target.name, self._target.variant)  # that all is there was seen when it opened
        return configured(test_case, self._target.variant)

    def _memory(self, test_case: TestCase) -> Memory:
        """Return the firmware's memory of the test case's settings; raises FirmwareDied if it dies of them."""
        base, parameters = user_memory.read(test_case.target.settings), test_case.target.parameters
        key = _key((parameters, base))
        if key not in self._configurations:
            self._configurations[key] = configure(self._target.variant, parameters, self._folder, base)
            if len(self._configurations) > CONFIGURATIONS_MAX:
                self._configurations.popitem(last=False)
        return self._configurations[key]

    def _cold(self, test_case: TestCase) -> BetaflightFlight:
        return BetaflightFlight(test_case, self._target.variant, self._memory(test_case), self._folder)

    def _begin(self, test_case: TestCase) -> BetaflightFlight:
        flight = self._cold(test_case)
        flight.begin()
        return flight

    def _warm_start(self, test_case: TestCase, stop: Cancelled) -> FlightRecord | None:
        """Fly from the start state of the test case, brought up if need be; None where that cannot be."""
        base = user_memory.read(test_case.target.settings)
        key = _key((test_case.target, test_case.scenario, test_case.rng_seed, base))
        if key not in self._starts:
            self._memory(test_case)  # known to the fork and to those after it
            if len(self._starts) >= WARM_STARTS_MAX:
                self._forks.drop(self._starts.popitem(last=False)[1])
            try:
                self._starts[key] = self._forks.hold(test_case, 0.0, stop)
            except Unavailable:
                if stop():
                    raise
                return None
        self._starts.move_to_end(key)
        return self._forks.fly_from(self._starts[key], test_case, stop)

    def _flown(
        self,
        test_case: TestCase,
        deadline_s: float,
        cancelled: Cancelled,
        act: Callable[[TestCase, Cancelled], FlightRecord | None],
    ) -> FlightRecord:
        """Have a flight flown by `act`, or from power-up where that gives none."""
        ready = self._ready(test_case)
        late_s = self._clock.monotonic_s() + deadline_s

        def stop() -> bool:
            return cancelled() or self._clock.monotonic_s() >= late_s

        try:
            record = self._flown_or_dead(ready.test_case, stop, act)
            if record.ending == "autopilot_died" and self._target.variant.sanitized:
                record = self._beside_plain(record, test_case, stop)
        except Unavailable:
            if self._clock.monotonic_s() < late_s:
                raise
            return FlightRecord("wedged", None, f"no end after {deadline_s:.1f} s of wall time")
        later = tuple(msgspec.structs.replace(one, index=ready.places[one.index]) for one in record.delivered or ())
        return record._replace(delivered=(*ready.given, *later))

    def _flown_or_dead(
        self, case: TestCase, stop: Cancelled, act: Callable[[TestCase, Cancelled], FlightRecord | None]
    ) -> FlightRecord:
        try:
            return act(case, stop) or self._cold(case).run(stop)
        except FirmwareDied as fault:
            return FlightRecord("autopilot_died", None, str(fault), ())

    def _beside_plain(self, record: FlightRecord, test_case: TestCase, stop: Cancelled) -> FlightRecord:
        """Return the record of a death with what the plain build makes of the same test case."""
        plain = VARIANTS["gps"]
        if missing(plain):
            words = "the plain build is not here"
        else:
            if self._plain is None:
                folder = self._folder / "plain"
                folder.mkdir(exist_ok=True)
                self._plain = BetaflightSession(BetaflightTarget("betaflight", plain), folder, self._clock)
            flown = self._plain.fly(test_case, PLAIN_DEADLINE_S, stop)
            words = {"autopilot_died": "the plain build dies, too"}.get(
                flown.ending, f"the plain build: {flown.ending}"
            )
        before, colon, place = record.message.partition(": ")
        return record._replace(message=f"{before} ({words}){colon}{place}")


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")


def _key(content: object) -> bytes:
    return _ENCODER.encode(content)
