"""Flights of which only a log is known: the test case and the record that go with it."""

from __future__ import annotations

from pathlib import Path

import msgspec

from saflite.contract.flight import Flight, Trace, trace_digest
from saflite.contract.test_case import DEFAULT_TARGET, Scenario, Target, TestCase, identity

_TARGETS = {".trace": DEFAULT_TARGET, ".ulg": "px4", ".bin": "ardupilot", ".BIN": "ardupilot"}


def empty_case(path: Path) -> TestCase:
    """Return a test case without obstacles and stimuli for a log nobody says more about."""
    return TestCase(target=Target(name=_TARGETS[path.suffix]), scenario=Scenario())


def flown_by(path: Path, case: TestCase) -> TestCase:
    """Return the test case with the autopilot that wrote the log as its target, which says what can be checked."""
    if path.suffix == ".trace":
        return case
    return msgspec.structs.replace(case, target=msgspec.structs.replace(case.target, name=_TARGETS[path.suffix]))


def flight_of(case: TestCase, trace: Trace) -> Flight:
    """Return the record of a flight of which only the trace is known; it counts as completed."""
    return Flight(
        test_case=identity(case),
        flight_index=0,
        ending="completed",
        simulated_s=trace.duration_s,
        trace_digest=trace_digest(trace),
    )
