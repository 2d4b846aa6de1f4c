"""Flight logs by what they begin with: our traces, PX4's ULog and extracts of it, ArduPilot's dataflash logs."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path

from saflite.contract.errors import FarmError, Refused
from saflite.contract.flight import TRACE_BYTES_MAX, Trace, unpack_trace
from saflite.contract.outside import begins_with, check_file, read_bytes
from saflite.flight.logs.flight_log import UNTOLD, FlightLog


def read_log(path: Path, *, placed: bool = False) -> FlightLog:
    """Return what a flight log tells; a stored trace tells itself alone.

    Raises:
        Refused: the file is missing, damaged or no log, or has no position (if `placed`).
    """
    check_file(path, "flight log")
    kind = kind_of(path)
    try:
        with _quiet():
            found = READERS[kind](path, placed=placed)
    except FarmError:
        raise
    except Exception as fault:  # others' parsers, and logs that lack what every log has
        raise Refused("flight log", where=str(path), expected="a whole log", got=_in_a_line(fault)) from fault
    return found if isinstance(found, FlightLog) else FlightLog(found)


def read_trace(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in a flight log.

    Raises:
        Refused: the file is missing or damaged, or has no position (if `placed`).
    """
    return read_log(path, placed=placed).trace


def kind_of(path: Path) -> str:
    """Return which of `READERS` a file is for: by its first bytes, as logs get renamed, else by the end of its name.

    Raises Refused for none of them.
    """
    kind = _begins_as(path)
    if kind:
        return kind
    kind = _SAME.get(path.suffix.lower(), path.suffix.lower())
    other = _of_another_kind(path, kind)
    if kind not in READERS or other:
        got = other or path.suffix or "no suffix"
        raise Refused("flight log", where=str(path), expected=", ".join(READERS), got=got)
    return kind


def _of_another_kind(path: Path, suffix: str) -> str:
    """Return in words what another log of flights a file is, empty where it is none that is known."""
    start = begins_with(path, _HEAD_BYTES) or b""
    if suffix in (".log", ".txt", ".bin") and _DESCRIBED.search(start):
        return "a DataFlash log as text; the autopilot keeps it as .bin, from which the text was made"
    if suffix not in READERS and start[_STAMP_BYTES : _STAMP_BYTES + 1] in _MAVLINK:
        return "telemetry as a ground station keeps it; judge the log of the autopilot itself"
    return ""


def begins_as_log(path: Path) -> bool:
    """Return whether a file begins as a log of an autopilot does, whatever its name."""
    return bool(_begins_as(path))


def _begins_as(path: Path) -> str:
    start = begins_with(path, len(ULOG_MAGIC)) or b""
    if start.startswith(ULOG_MAGIC):
        return ".ulg"
    return ".bin" if start.startswith(DATAFLASH_HEAD) else ""


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep to itself what the parsers print of a damaged log: pyulog on stdout, pymavlink's indexer in C on stderr."""
    with suppress(OSError, ValueError):
        sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _in_a_line(fault: Exception) -> str:
    return " ".join(f"{type(fault).__name__}: {fault}".split())[:200]


def _packed(path: Path, *, placed: bool = True) -> Trace:
    return unpack_trace(read_bytes(path, "trace", TRACE_BYTES_MAX))


def _ulog(path: Path, *, placed: bool = True) -> FlightLog:
    from saflite.flight.logs.ulog import read_ulog_log

    return read_ulog_log(path, placed=placed)


def _extract(path: Path, *, placed: bool = True) -> FlightLog:
    from saflite.flight.logs.extract import read_extract
    from saflite.flight.logs.ulog import SOURCES

    return FlightLog(read_extract(path, placed=placed), sources=SOURCES, untold=UNTOLD)


def _dataflash(path: Path, *, placed: bool = True) -> FlightLog:
    from saflite.flight.logs.dataflash import read_dataflash_log

    return read_dataflash_log(path, placed=placed)


READERS: dict[str, Callable[..., Trace | FlightLog]] = {
    ".trace": _packed,
    ".ulg": _ulog,
    ".bin": _dataflash,
    ".csv": _extract,
}
ULOG_MAGIC, DATAFLASH_HEAD = b"ULog\x01\x12\x35", b"\xa3\x95"
_HEAD_BYTES, _DESCRIBED = 4096, re.compile(rb"^\s*FMT, ?\d", re.MULTILINE)
_STAMP_BYTES, _MAVLINK = 8, (b"\xfe", b"\xfd")  # a time before each message, which begins so in MAVLink 1 and 2
_SAME = {".ulog": ".ulg"}
SUFFIXES = (*READERS, *_SAME)
"""What names of logs end in, in small letters."""
