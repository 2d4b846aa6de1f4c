"""The reference target at the pace of a simulator bound to real time: each flight takes four seconds of wall time.

For measuring how well scoring and flying overlap without the machine's cores being the limit.
"""

from __future__ import annotations

import time

import msgspec

from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Session, Slot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET, TestCase
from saflite.simulator_worker.targets import reference

FLIGHT_S = 4.0


def describe() -> TargetInfo:
    """Say what the reference target says, under another name."""
    return msgspec.structs.replace(reference.describe(), name="paced", snapshots=False)


def check(test_case: TestCase) -> None:
    """Take what the reference target takes."""
    reference.check(_plain(test_case))


def open(slot: Slot) -> PacedSession:  # noqa: A001  (the name that the contract gives it)
    """Return a session."""
    return PacedSession(reference.open(slot))


class PacedSession:
    """Flies on the reference target and takes its time."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly on the reference target, then wait until four seconds have passed."""
        started_s = time.monotonic()
        record = self._session.fly(_plain(test_case), deadline_s, cancelled)
        while time.monotonic() < started_s + FLIGHT_S and not cancelled():
            time.sleep(0.02)
        return record

    def close(self) -> None:
        """Close the reference session."""
        self._session.close()


def _plain(test_case: TestCase) -> TestCase:
    return msgspec.structs.replace(test_case, target=msgspec.structs.replace(test_case.target, name=DEFAULT_TARGET))
