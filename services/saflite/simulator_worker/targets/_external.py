"""Targets with a binary that a person names: in lockstep with our world, a process for each flight."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Slot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external.adapter import Adapter
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.describe import missing
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import Place
from saflite.simulator_worker.slots import take_slot


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
        return ExternalSession(slot, self.adapter, *self.binary())

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
            return self.adapter.ask(binary, Place(Path(info.folder), ports))
        finally:
            held.release()


class ExternalSession:
    """Flies each test case in a process of its own, so that nothing of a flight reaches the next."""

    def __init__(self, slot: Slot, adapter: Adapter, binary: Binary, listing: Listing) -> None:
        self._slot, self._adapter, self._binary, self._listing = slot, adapter, binary, listing

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once; `wedged` where `deadline_s` is not enough.

        Raises:
            Refused: the binary cannot fly the test case.
            Unavailable: JSBSim or the autopilot does not come up, or the flight was cancelled.
        """
        self._adapter.check(test_case, self._listing)
        clock = self._slot.clock
        late_s = clock.monotonic_s() + deadline_s
        place = Place(self._slot.folder, self._slot.ports)
        flight = self._adapter.flight(test_case, self._binary, self._listing, place)
        try:
            return flight.run(lambda: cancelled() or clock.monotonic_s() >= late_s)
        except Unavailable:
            if clock.monotonic_s() < late_s:
                raise
            return FlightRecord("wedged", None, f"no end after {deadline_s:.1f} s of wall time")

    def close(self) -> None:
        """Nothing outlives a flight."""
