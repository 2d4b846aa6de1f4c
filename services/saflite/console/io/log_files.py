"""Flights of which only a log is known: the test case and the record that go with it."""

from __future__ import annotations

import msgspec

from saflite.contract.flight import Flight, trace_digest
from saflite.contract.test_case import DEFAULT_TARGET, Scenario, Target, TestCase, identity
from saflite.flight.logs.flight_log import FlightLog

_TARGETS = {".trace": DEFAULT_TARGET, ".bin": "ardupilot"}


def case_of(kind: str, log: FlightLog, known: TestCase | None) -> TestCase:
    """Return what was flown as far as the log tells: its autopilot as target, what was changed and ordered in flight.

    Args:
        kind: the kind of log (`kind_of`), which tells the autopilot.
        log: what was read of it.
        known: what somebody says of the flight (obstacles, mission); its inputs stand where the log tells of none.
    """
    if kind == ".trace" and known is not None:
        return known
    case = known or TestCase(target=Target(), scenario=Scenario())
    target = msgspec.structs.replace(case.target, name=_TARGETS.get(kind, "px4"))
    return msgspec.structs.replace(case, target=target, stimuli=log.stimuli or case.stimuli)


def flight_of(case: TestCase, log: FlightLog) -> Flight:
    """Return the record of a flight of which only the log is known: completed, unless the log tells of a crash."""
    return Flight(
        test_case=identity(case),
        flight_index=0,
        ending="crashed" if log.crashed else "completed",
        simulated_s=log.trace.duration_s,
        trace_digest=trace_digest(log.trace),
    )
