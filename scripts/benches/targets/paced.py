"""The reference target at the pace of a simulator bound to real time: each flight takes four seconds of wall time.

For measuring how well scoring and flying overlap without the machine's cores being the limit.
"""

from __future__ import annotations

import time

import msgspec

from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET, TestCase

FLIGHT_S = 4.0


def describe() -> TargetInfo:
    """Say what the reference target says, under this target's name."""
    from saflite.simulator_worker.targets import reference

    return msgspec.structs.replace(reference.describe(), name="paced", snapshots=False)


def check(test_case: TestCase) -> None:
    """Take what the reference target takes."""
    from saflite.simulator_worker.targets import reference

    reference.check(_plain(test_case))


def fly(test_case: TestCase, cancelled: Cancelled) -> FlightRecord:
    """Fly on the reference target, then wait until four seconds have passed."""
    from saflite.simulator_worker.targets import reference

    started_s = time.monotonic()
    record = reference.fly(_plain(test_case), cancelled)
    while time.monotonic() < started_s + FLIGHT_S and not cancelled():
        time.sleep(0.02)
    return record


def _plain(test_case: TestCase) -> TestCase:
    return msgspec.structs.replace(test_case, target=msgspec.structs.replace(test_case.target, name=DEFAULT_TARGET))
