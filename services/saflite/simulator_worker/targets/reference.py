"""Reference target: our own flight stack on JSBSim's F450. Deterministic: same test case, bit-equal trace."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from saflite.contract.clock import Clock
from saflite.contract.errors import Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Slot, Snapshot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.reference.check import check_test_case
from saflite.flight.autopilots.reference.describe import describe as describe_reference
from saflite.flight.autopilots.reference.flight import ReferenceFlight
from saflite.simulator_worker.forks import Forks

T = TypeVar("T")


def describe() -> TargetInfo:
    """Say what the target is and can do; raises Unavailable where the native library was not built."""
    return describe_reference()


def check(test_case: TestCase) -> None:
    """Raise Refused where this target cannot fly the test case."""
    check_test_case(test_case)


def open(slot: Slot) -> ReferenceSession:  # noqa: A001  (the name that the contract gives it)
    """Return a session; raises Unavailable where this machine lacks something."""
    missing = describe().missing
    if missing:
        raise Unavailable(f"target reference: {missing}")
    return ReferenceSession(slot.clock)


def serve(endpoint: str, clock: Clock, **options: Any) -> None:
    """Serve the vehicle over MAVLink; options and troubles as of `flight.autopilots.reference.sitl.serve`."""
    from saflite.flight.autopilots.reference import sitl

    sitl.serve(endpoint, clock, **options)


class ReferenceSession:
    """Flies in this process; holds snapshots as forks of it, which must run one thread then."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._forks = Forks(_begin)

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once; `wedged` where `deadline_s` is not enough.

        Raises:
            Refused: this target cannot fly the test case.
            Unavailable: JSBSim does not come up, or the flight was cancelled.
        """
        check(test_case)
        return self._within(deadline_s, cancelled, lambda stop: ReferenceFlight(test_case).run(stop))

    def snapshot(self, test_case: TestCase, at_s: float, deadline_s: float, cancelled: Cancelled) -> Snapshot:
        """Fly up to `at_s` and hold; raises Unavailable where the flight ends before, is late or cancelled."""
        check(test_case)
        late_s = self._clock.monotonic_s() + deadline_s
        return self._forks.hold(test_case, at_s, lambda: cancelled() or self._clock.monotonic_s() >= late_s)

    def fly_from(
        self, snapshot: Snapshot, test_case: TestCase, deadline_s: float, cancelled: Cancelled
    ) -> FlightRecord:
        """Fly on from the snapshot, or from the start where that cannot be; the outcome is the same. See `fly`."""
        check(test_case)
        return self._within(
            deadline_s,
            cancelled,
            lambda stop: self._forks.fly_from(snapshot, test_case, stop) or ReferenceFlight(test_case).run(stop),
        )

    def drop(self, snapshot: Snapshot) -> None:
        """Let go of a snapshot, and of those held on from it."""
        self._forks.drop(snapshot)

    def close(self) -> None:
        """End the processes that hold snapshots."""
        self._forks.close()

    def _within(
        self, deadline_s: float, cancelled: Cancelled, act: Callable[[Cancelled], FlightRecord]
    ) -> FlightRecord:
        late_s = self._clock.monotonic_s() + deadline_s
        try:
            return act(lambda: cancelled() or self._clock.monotonic_s() >= late_s)
        except Unavailable:
            if self._clock.monotonic_s() < late_s:
                raise
            return FlightRecord("wedged", None, f"no end after {deadline_s:.1f} s of wall time")


def _begin(test_case: TestCase) -> ReferenceFlight:
    flight = ReferenceFlight(test_case)
    flight.begin()
    return flight
