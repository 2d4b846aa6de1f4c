"""What a worker and its simulator process say to each other, over a socket of their own."""

from __future__ import annotations

from multiprocessing.connection import Connection
from pathlib import Path
from typing import Literal

import msgspec

from saflite.contract import wire
from saflite.contract.clock import Clock
from saflite.contract.flight import Delivered, Ending
from saflite.contract.target import Slot
from saflite.contract.test_case import TestCase

Trouble = Literal["none", "refused", "unavailable", "contradicted", "raised"]
"""Why a request was not done: bad input, something missing or cancelled, the target does not do what it says."""


class SlotInfo(msgspec.Struct, frozen=True, kw_only=True):
    """A slot without its clock."""

    index: int
    folder: str
    first_port: int
    ports: int

    def slot(self, clock: Clock) -> Slot:
        """Return the slot with a clock."""
        ports = range(self.first_port, self.first_port + self.ports)
        return Slot(index=self.index, folder=Path(self.folder), clock=clock, ports=ports)


class Setup(msgspec.Struct, frozen=True, kw_only=True, tag="setup"):
    """Said once to a new process. At most `snapshots_max` snapshots are held, 0 for none."""

    slot: SlotInfo
    target_files: tuple[str, ...] = ()
    snapshots_max: int = 0


class Ready(msgspec.Struct, frozen=True, kw_only=True, tag="ready"):
    """The answer: the targets this process can fly, each with its build."""

    builds: dict[str, str]


class OpenRequest(msgspec.Struct, frozen=True, kw_only=True, tag="open"):
    """Open a session of `target`, instead of the one that is open."""

    target: str


class Opened(msgspec.Struct, frozen=True, kw_only=True, tag="opened"):
    """What became of it; `repeats` says whether every flight of the target can be repeated bit by bit."""

    build: str = ""
    repeats: bool = False
    trouble: Trouble = "none"
    message: str = ""


class FlightRequest(msgspec.Struct, frozen=True, kw_only=True, tag="fly"):
    """Fly `test_case` on the open session as flight number `number` of this process.

    `twice`: fly it again and compare. `share`: may begin from a snapshot of an earlier flight that began the same.
    """

    number: int
    test_case: TestCase
    deadline_s: float
    twice: bool = False
    share: bool = False


def flights_in(request: FlightRequest) -> int:
    """Return how many flights a request takes, each of which may last as long as its deadline."""
    return 1 + request.twice + bool(request.test_case.twin)


class Cancel(msgspec.Struct, frozen=True, kw_only=True, tag="cancel"):
    """Stop flight number `number`."""

    number: int


class FlightReply(msgspec.Struct, frozen=True, kw_only=True, tag="flown"):
    """How the flight ended; `trouble` says whether it was flown at all."""

    number: int
    ending: Ending = "infra"
    trace: bytes = b""
    trace_digest: str = ""
    simulated_s: float = 0.0
    message: str = ""
    build: str = ""
    delivered: tuple[Delivered, ...] | None = None
    artefacts: dict[str, bytes] = {}
    trouble: Trouble = "none"


ToSimulator = Setup | OpenRequest | FlightRequest | Cancel
FromSimulator = Ready | Opened | FlightReply

_ENCODER = msgspec.msgpack.Encoder()


def send(pipe: Connection, message: ToSimulator | FromSimulator) -> None:
    """Send a message; raises OSError if the other side is gone."""
    pipe.send_bytes(_ENCODER.encode(message))


def to_simulator(pipe: Connection) -> ToSimulator:
    """Wait for and return the next message of the worker; raises EOFError if it is gone."""
    message: ToSimulator = wire.unpack(pipe.recv_bytes(), ToSimulator)
    return message


def from_simulator(pipe: Connection) -> FromSimulator:
    """Wait for and return the next message of the simulator; raises EOFError or OSError if it is gone."""
    message: FromSimulator = wire.unpack(pipe.recv_bytes(), FromSimulator)
    return message
