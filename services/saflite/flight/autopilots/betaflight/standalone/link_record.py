"""A flight recorded at the firmware's link: every message to it, and its answers (`native/link.h`)."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from saflite.flight.autopilots.betaflight.process import Firmware, start

DOWN_HEAD = 212
MESSAGE_MAX = 65_536
_ROW = struct.Struct("<II")  # bytes of the message, bytes of its answer


class LinkRecord(NamedTuple):
    """Messages to the firmware, in order, and the answer to each; empty to the last where it died of it."""

    messages: tuple[bytes, ...]
    answers: tuple[bytes, ...]


class Tap:
    """Starts a firmware whose link leads through a process of ours that writes down what passes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._relay = 0

    def start(self, binary: Path, clock_library: Path, folder: Path) -> Firmware:
        """Start it as `process.start` does, with the same troubles."""
        firmware = start(binary, clock_library, folder)
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._relay = os.fork()
        if not self._relay:
            ours.close()
            _relay(theirs, socket.socket(fileno=os.dup(firmware.fd)), firmware, self._path)
            os._exit(0)
        theirs.close()
        return firmware.through(ours)

    def read(self) -> LinkRecord:
        """Return what passed, once the flight is over and its link closed."""
        os.waitpid(self._relay, 0)
        rows = tuple(_rows(self._path.read_bytes()))
        return LinkRecord(tuple(message for message, _ in rows), tuple(answer for _, answer in rows))


def _relay(world: socket.socket, firmware: socket.socket, inherited: Firmware, path: Path) -> None:
    inherited.leave()
    first = firmware.recv(MESSAGE_MAX)  # its word that it has started
    world.send(first)
    with path.open("wb") as file:
        while message := world.recv(MESSAGE_MAX):
            answer = _exchanged(firmware, message)
            file.write(_ROW.pack(len(message), len(answer)) + message + answer)
            if not answer:
                return
            world.send(answer)


def _exchanged(firmware: socket.socket, message: bytes) -> bytes:
    try:
        firmware.send(message)
        return firmware.recv(MESSAGE_MAX)
    except OSError:
        return b""


def _rows(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = 0
    while at < len(data):
        size, answer_size = _ROW.unpack_from(data, at)
        message = at + _ROW.size
        at = message + size + answer_size
        yield data[message : message + size], data[message + size : at]
