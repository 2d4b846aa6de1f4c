"""Reference target: our own flight stack on JSBSim's F450. Deterministic: same test case, bit-equal trace."""

from __future__ import annotations

from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.reference.check import check_test_case
from saflite.flight.autopilots.reference.describe import describe as describe_reference
from saflite.flight.autopilots.reference.describe import missing as missing_here


def describe() -> TargetInfo:
    """Say what the target is and can do; raises Unavailable where the native library was not built."""
    return describe_reference()


def check(test_case: TestCase) -> None:
    """Raise Refused where this target cannot fly the test case."""
    check_test_case(test_case)


def fly(test_case: TestCase, cancelled: Cancelled) -> FlightRecord:
    """Fly the test case once; raises Refused (bad input) or Unavailable (JSBSim missing, cancelled)."""
    from saflite.flight.autopilots.reference.flight import ReferenceFlight

    check(test_case)
    return ReferenceFlight(test_case).run(cancelled)


def missing() -> str:
    """Return what this machine lacks to fly, empty if nothing."""
    return missing_here()
