"""Traces from files: ours, PX4's and ArduPilot's."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from pathlib import Path

import msgspec

from saflite.contract.errors import Refused
from saflite.contract.flight import Flight, Trace, trace_digest, unpack_trace
from saflite.contract.test_case import Scenario, Target, TestCase, identity


def _packed(path: Path, *, placed: bool = True) -> Trace:
    try:
        return unpack_trace(path.read_bytes())
    except OSError as fault:
        raise Refused("trace", where=str(path), expected="a readable file", got=str(fault)) from fault


def _ulog(path: Path, *, placed: bool = True) -> Trace:
    from saflite.flight.logs.ulog import read_ulog

    with contextlib.redirect_stdout(io.StringIO()):  # pyulog prints what it thinks of a damaged file
        return read_ulog(path, placed=placed)


def _dataflash(path: Path, *, placed: bool = True) -> Trace:
    from saflite.flight.logs.dataflash import read_dataflash

    return read_dataflash(path, placed=placed)


READERS: dict[str, Callable[..., Trace]] = {".trace": _packed, ".ulg": _ulog, ".bin": _dataflash, ".BIN": _dataflash}
_TARGETS = {".trace": "reference", ".ulg": "px4", ".bin": "ardupilot", ".BIN": "ardupilot"}


def read_trace(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in a file; raises Refused if it is missing, damaged, or (if `placed`) without position."""
    if not path.is_file():
        raise Refused("flight log", where=str(path), expected="a readable file", got="none")
    return READERS[path.suffix](path, placed=placed)


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
