"""PX4: the simulator build that a person names, in lockstep with our world; a process for each flight."""

from __future__ import annotations

from pathlib import Path

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Slot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.place import Place
from saflite.flight.autopilots.px4 import listing
from saflite.flight.autopilots.px4.binary import Binary, named
from saflite.flight.autopilots.px4.check import check_test_case
from saflite.flight.autopilots.px4.describe import describe as describe_binary
from saflite.flight.autopilots.px4.describe import missing
from saflite.flight.autopilots.px4.flight import Px4Flight
from saflite.simulator_worker.slots import take_slot


def describe() -> TargetInfo:
    """Say what the target is and can do; a binary never seen before is started once to list its parameters.

    Raises:
        Unavailable: the native library was not built.
    """
    try:
        binary, rows = _binary()
    except (Refused, Unavailable) as fault:
        return describe_binary(None, None, str(fault))
    return describe_binary(binary, rows, "")


def check(test_case: TestCase) -> None:
    """Raise Refused where the binary cannot fly the test case, Unavailable where there is none."""
    check_test_case(test_case, _binary()[1])


def open(slot: Slot) -> Px4Session:  # noqa: A001  (the name that the contract gives it)
    """Return a session; raises Unavailable where there is no binary or this machine lacks something."""
    binary, rows = _binary()
    return Px4Session(slot, binary, rows)


def parameters_known() -> tuple[int, int]:
    """Return how many parameters the binary has, and for how many of them a range is documented.

    Raises:
        Unavailable: there is no binary, or it does not come up.
        Refused: it cannot fly here.
    """
    _, rows = _binary()
    ranged = [one for one in describe().inputs if one.low is not None and one.kind in ("parameter", "sensor_fault")]
    return len(rows.parameters), len(ranged)


class Px4Session:
    """Flies each test case in a process of its own, so that nothing of a flight reaches the next."""

    def __init__(self, slot: Slot, binary: Binary, rows: Listing) -> None:
        self._slot, self._binary, self._listing = slot, binary, rows

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly once; `wedged` where `deadline_s` is not enough.

        Raises:
            Refused: the binary cannot fly the test case.
            Unavailable: JSBSim or the autopilot does not come up, or the flight was cancelled.
        """
        check_test_case(test_case, self._listing)
        clock = self._slot.clock
        late_s = clock.monotonic_s() + deadline_s
        flight = Px4Flight(test_case, self._binary, self._listing, self._place)
        try:
            return flight.run(lambda: cancelled() or clock.monotonic_s() >= late_s)
        except Unavailable:
            if clock.monotonic_s() < late_s:
                raise
            return FlightRecord("wedged", None, f"no end after {deadline_s:.1f} s of wall time")

    def close(self) -> None:
        """Nothing outlives a flight."""

    @property
    def _place(self) -> Place:
        return Place(self._slot.folder, self._slot.ports)


def _binary() -> tuple[Binary, Listing]:
    lacking = missing()
    if lacking:
        raise Unavailable(lacking)
    binary = named()
    remembered = listing.known(binary)
    return binary, remembered if remembered is not None else _asked(binary)


def _asked(binary: Binary) -> Listing:
    """Have the binary list its parameters, in a slot of its own."""
    held = take_slot()
    info = held.info
    try:
        return listing.ask(binary, Place(Path(info.folder), range(info.first_port, info.first_port + info.ports)))
    finally:
        held.release()
