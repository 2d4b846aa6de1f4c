"""Targets with a binary that a person names: in lockstep with our world, a process for each flight."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Slot, Snapshot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external.adapter import Adapter
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.describe import missing
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import Place
from saflite.simulator_worker.forks import Forks
from saflite.simulator_worker.prefixes import agree_until_s
from saflite.simulator_worker.processes import no_strays
from saflite.simulator_worker.slots import take_slot

ASKED_S = 90.0
"""A build asked for its parameters, which takes a second or two, is ended at this age: no sandbox watches it."""
_NOT_HELD = 0  # no snapshot has this handle


class ExternalTarget(NamedTuple):
    """What a target module offers, for one autopilot."""

    adapter: Adapter

    def describe(self) -> TargetInfo:
        """Say what the target is and can do; a binary never seen before is started once to list its parameters.

        Raises:
            Unavailable: the native library was not built.
        """
        try:
            binary, listing = self.binary()
        except (Refused, Unavailable) as fault:
            return self.adapter.describe(None, None, str(fault))
        return self.adapter.describe(binary, listing, "")

    def check(self, test_case: TestCase) -> None:
        """Raise Refused where the binary cannot fly the test case, Unavailable where there is none."""
        self.adapter.check(test_case, self.binary()[1])

    def open(self, slot: Slot) -> ExternalSession:
        """Return a session; raises Unavailable where there is no binary or this machine lacks something."""
        _check_ports(slot.ports)
        made = ExternalSession if self.adapter.held is None else ForkingExternalSession
        return made(slot, self.adapter, *self.binary())

    def parameters_known(self) -> tuple[int, int]:
        """Return how many parameters the binary has, and for how many of them a range is documented.

        Raises:
            Unavailable: there is no binary, or it does not come up.
            Refused: it cannot fly here.
        """
        _, listing = self.binary()
        given = [one for one in self.describe().inputs if one.kind in ("parameter", "sensor_fault")]
        return len(listing.parameters), len([one for one in given if one.low is not None])

    def binary(self) -> tuple[Binary, Listing]:
        """Return the binary that is named and its parameters, which it is asked for where they are not known.

        Raises:
            Unavailable: there is none, or it does not come up.
            Refused: it cannot fly here.
        """
        lacking = missing()
        if lacking:
            raise Unavailable(lacking)
        binary = self.adapter.binaries.named()
        known = self.adapter.known(binary)
        return binary, known if known is not None else self._asked(binary)

    def _asked(self, binary: Binary) -> Listing:
        """Have the binary list its parameters, in a slot of its own."""
        held = take_slot()
        info = held.info
        try:
            ports = range(info.first_port, info.first_port + info.ports)
            _check_ports(ports)
            with no_strays():
                return self.adapter.ask(binary, Place(Path(info.folder), ports, ASKED_S))
        finally:
            held.release()


def _check_ports(ports: range) -> None:
    if not ports:
        raise Unavailable("no ports: others on this host have claimed all those that simulators may have")


class ExternalSession:
    """Flies each test case in a process of its own, so that nothing of a flight reaches the next."""

    def __init__(self, slot: Slot, adapter: Adapter, binary: Binary, listing: Listing) -> None:
        self._slot, self._adapter, self._binary, self._listing = slot, adapter, binary, listing

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once; `wedged` where `deadline_s` is not enough.

        Raises:
            Refused: the binary cannot fly the test case, or another lies in its place.
            Unavailable: JSBSim or the autopilot does not come up, or the flight was cancelled.
        """
        return self._flown(test_case, deadline_s, cancelled, self._cold)

    def close(self) -> None:
        """Nothing outlives a flight."""

    def repeatable(self, test_case: TestCase) -> bool:
        """Return whether flights of a test case repeat bit by bit, where the target says that flights do."""
        return self._adapter.repeatable(test_case, self._binary)

    @property
    def _place(self) -> Place:
        return Place(self._slot.folder, self._slot.ports)

    def _cold(self, test_case: TestCase, stop: Cancelled) -> FlightRecord:
        return self._adapter.flight(test_case, self._binary, self._listing, self._place).run(stop)

    def _flown(
        self,
        test_case: TestCase,
        deadline_s: float,
        cancelled: Cancelled,
        act: Callable[[TestCase, Cancelled], FlightRecord],
    ) -> FlightRecord:
        self._adapter.binaries.check_same(self._binary)
        self._adapter.check(test_case, self._listing)
        clock = self._slot.clock
        late_s = clock.monotonic_s() + deadline_s
        try:
            return act(test_case, lambda: cancelled() or clock.monotonic_s() >= late_s)
        except Unavailable:
            if clock.monotonic_s() < late_s:
                raise
            return FlightRecord("wedged", None, f"no end after {deadline_s:.1f} s of wall time")


class ForkingExternalSession(ExternalSession):
    """Keeps the last start state and forks flights from it; test cases that cannot be forked are flown from power-up.

    One at a time, since a held autopilot keeps the slot's ports: another start, or a flight from power-up, ends it.
    """

    def __init__(self, slot: Slot, adapter: Adapter, binary: Binary, listing: Listing) -> None:
        super().__init__(slot, adapter, binary, listing)
        self._forks = Forks(self._begin)
        self._start: tuple[TestCase, Snapshot] | None = None
        self._unheld: set[bytes] = set()  # beginnings that were tried in vain

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once, from the held start state where there is one; see `ExternalSession`."""
        return self._flown(test_case, deadline_s, cancelled, lambda case, stop: self._from(None, case, stop))

    def fly_cold(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once from power-up, without any fork; the outcome is that of `fly`."""
        return self._flown(test_case, deadline_s, cancelled, self._cold)

    def snapshot(self, test_case: TestCase, at_s: float, deadline_s: float, cancelled: Cancelled) -> Snapshot:
        """Fly up to `at_s` and hold; where that cannot be, one is returned from which all is flown from power-up.

        Raises:
            Refused: as `fly`.
            Unavailable: the flight ends before, is late or cancelled.
        """
        self._adapter.binaries.check_same(self._binary)
        self._adapter.check(test_case, self._listing)
        clock = self._slot.clock
        late_s = clock.monotonic_s() + deadline_s

        def stop() -> bool:
            return cancelled() or clock.monotonic_s() >= late_s

        if self._held(test_case, stop) is None:
            return Snapshot(_NOT_HELD, at_s)
        return self._forks.hold(test_case, at_s, stop)

    def fly_from(
        self, snapshot: Snapshot, test_case: TestCase, deadline_s: float, cancelled: Cancelled
    ) -> FlightRecord:
        """Fly on from the snapshot, or from the start where that cannot be; the outcome is the same. See `fly`."""
        return self._flown(test_case, deadline_s, cancelled, lambda case, stop: self._from(snapshot, case, stop))

    def drop(self, snapshot: Snapshot) -> None:
        """Let go of a snapshot, and of those held on from it."""
        self._forks.drop(snapshot)

    def close(self) -> None:
        """End the processes that hold start state and snapshots."""
        self._start = None
        self._forks.close()

    def _from(self, snapshot: Snapshot | None, test_case: TestCase, stop: Cancelled) -> FlightRecord:
        record = None if snapshot is None else self._forks.fly_from(snapshot, test_case, stop)
        if record is None and (start := self._held(test_case, stop)) is not None:
            record = self._forks.fly_from(start, test_case, stop)
        return record or self._cold(test_case, stop)

    def _cold(self, test_case: TestCase, stop: Cancelled) -> FlightRecord:
        self.close()
        return super()._cold(test_case, stop)

    def _begin(self, test_case: TestCase) -> Any:
        assert self._adapter.held is not None, "a session that cannot fork was asked to"
        flight = self._adapter.held(test_case, self._binary, self._listing, self._place)
        flight.begin()
        return flight

    def _held(self, test_case: TestCase, stop: Cancelled) -> Snapshot | None:
        """Return the test case's start state, reached if need be; None where it cannot be held."""
        if self._start is not None and agree_until_s(self._start[0], test_case) >= 0.0:
            return self._start[1]
        beginning = _ENCODER.encode((test_case.target, test_case.scenario, test_case.rng_seed, test_case.heading_deg))
        if beginning in self._unheld or not self._adapter.forkable(test_case):
            return None
        self.close()
        try:
            self._start = (test_case, self._forks.hold(test_case, 0.0, stop))
        except Unavailable:
            if stop():
                raise
            self._unheld.add(beginning)
            return None
        return self._start[1]


_ENCODER = msgspec.msgpack.Encoder(order="deterministic")
