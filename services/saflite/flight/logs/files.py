"""Flight logs by the ending of their names: our traces, PX4's ULog and extracts of it, ArduPilot's dataflash logs."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path

from saflite.contract.errors import FarmError, Refused
from saflite.contract.flight import TRACE_BYTES_MAX, Trace, unpack_trace
from saflite.contract.outside import check_file, read_bytes
from saflite.flight.logs.flight_log import UNTOLD, FlightLog


def read_log(path: Path, *, placed: bool = False) -> FlightLog:
    """Return what a flight log tells; a stored trace tells itself alone.

    Raises:
        Refused: the file is missing or damaged, or has no position (if `placed`).
    """
    check_file(path, "flight log")
    try:
        with _quiet():
            found = READERS[path.suffix](path, placed=placed)
    except FarmError:
        raise
    except Exception as fault:  # others' parsers, and logs that lack what every log has
        raise Refused("flight log", where=str(path), expected="a whole log", got=_in_a_line(fault)) from fault
    return found if isinstance(found, FlightLog) else FlightLog(found)


def read_trace(path: Path, *, placed: bool = True) -> Trace:
    """Return the trace in a flight log; its suffix must be one of `READERS`.

    Raises:
        Refused: the file is missing or damaged, or has no position (if `placed`).
    """
    return read_log(path, placed=placed).trace


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
    ".BIN": _dataflash,
    ".csv": _extract,
}
