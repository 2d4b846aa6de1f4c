"""The simulator's own process: takes test cases over a socket, flies them, sends the records back.

Run by `sandbox.py` as `python -m saflite.simulator_worker.child FD PARENT_PID [TARGET_FILE ...]`. It leads its own
process group, dies with the worker, and keeps the interpreter lock of the simulator away from the worker's heartbeats.
"""

from __future__ import annotations

import os
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Literal

import msgspec

from saflite.contract import wire
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import Ending, pack_trace, trace_digest
from saflite.contract.test_case import TestCase
from saflite.simulator_worker.processes import die_with_parent
from saflite.simulator_worker.registry import flyable, load_target


class Ready(msgspec.Struct, frozen=True, kw_only=True):
    """Said once at the start: the targets this process can fly."""

    targets: tuple[str, ...]


class FlightRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Fly `test_case` as flight number `number` of this process, or (None) cancel that flight."""

    number: int
    test_case: TestCase | None = None


class FlightReply(msgspec.Struct, frozen=True, kw_only=True):
    """How the flight ended; `trouble` says whether it was flown at all."""

    number: int
    ending: Ending = "infra"
    trace: bytes = b""
    trace_digest: str = ""
    simulated_s: float = 0.0
    message: str = ""
    trouble: Literal["none", "refused", "unavailable"] = "none"


def fly(request: FlightRequest, test_case: TestCase, pipe: Connection, files: list[Path]) -> FlightReply:
    """Fly one test case and return what became of it; trouble of our own code ends the process."""

    def cancelled() -> bool:
        while pipe.poll():
            if wire.decode(pipe.recv_bytes(), FlightRequest).number == request.number:
                return True
        return False

    try:
        record = load_target(test_case.target.name, files).fly(test_case, cancelled)
    except Refused as fault:
        return FlightReply(number=request.number, trouble="refused", message=str(fault))
    except Unavailable as fault:
        return FlightReply(number=request.number, trouble="unavailable", message=str(fault))
    if record.trace is None:
        return FlightReply(number=request.number, ending=record.ending, message=record.message)
    return FlightReply(
        number=request.number,
        ending=record.ending,
        trace=pack_trace(record.trace),
        trace_digest=trace_digest(record.trace),
        simulated_s=record.trace.duration_s,
        message=record.message,
    )


def main(argv: list[str]) -> None:
    """Serve the socket until the worker closes it."""
    die_with_parent(int(argv[1]))
    pipe = Connection(int(argv[0]))
    files = [Path(word) for word in argv[2:]]
    pipe.send_bytes(wire.encode(Ready(targets=flyable(files))))
    while True:
        try:
            request = wire.decode(pipe.recv_bytes(), FlightRequest)
        except EOFError:
            os._exit(0)
        if request.test_case is not None:
            pipe.send_bytes(wire.encode(fly(request, request.test_case, pipe, files)))


if __name__ == "__main__":
    main(sys.argv[1:])
