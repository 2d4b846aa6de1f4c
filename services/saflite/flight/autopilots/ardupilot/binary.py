"""Which binary flies: the one a person names. It is known by its content; its path goes nowhere.

The autopilot is an external program under the GPL-3; nothing of it is part of this package.
"""

from __future__ import annotations

import hashlib
import mmap
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.flight.autopilots.external.binary import Binaries, Binary, check_runnable
from saflite.flight.autopilots.external.elf import check_program

AUTOPILOT = "ardupilot"
WANTED = "name a build of ArduCopter for its simulator (SITL)"
VEHICLES = ("ArduCopter", "ArduPlane", "ArduRover", "Rover", "ArduSub", "AntennaTracker", "Blimp")
_VERSION = re.compile(rb"(?<![\w ])((?:" + "|".join(VEHICLES).encode() + rb") V\d[\w.\- ]{0,60})")
_PX4 = b"px4_daemon"
_BACKEND = b"JSON control interface set to"
_SERIAL, _START_TIME = b"--serial0", b"--start-time"
_NAMES_THREADS = b"pthread_setname_np"
_TELLS_EKF = b"EKF Failsafe"


class Options(NamedTuple):
    """What builds call differently on their command line; `link` names the first serial port."""

    link: str
    start_time: bool


@cache
def _inspected(path: Path, state: int) -> Binary:
    where = str(path)
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        check_program(content[:20], where, WANTED)
        found = _VERSION.search(content)
        if found is None:
            got = "a PX4 binary" if content.find(_PX4) >= 0 else "a program without ArduPilot's version"
            raise Refused("autopilot", where=where, expected="ArduCopter", got=got, fix=WANTED)
        version = found[1].decode().strip()
        if not version.startswith("ArduCopter "):
            raise Refused("autopilot", where=where, expected="ArduCopter: the world is a quadrotor", got=version)
        if content.find(_BACKEND) < 0:
            expected = "a build for the simulator with its JSON backend"
            raise Refused("autopilot", where=where, expected=expected, got=f"{version} without", fix=WANTED)
        check_runnable(path)
        return Binary(path, hashlib.sha256(content).hexdigest(), version)


def options_of(binary: Binary) -> Options:
    """Return what a build's command line takes, by its own help: ports were UARTs until 4.2, and no time was told."""
    return Options("--serial0" if _holds(binary, _SERIAL) else "--uartA", start_time=_holds(binary, _START_TIME))


def names_threads(binary: Binary) -> bool:
    """Return whether a build names its threads, so that the gate knows which of them plans ways round obstacles."""
    return _holds(binary, _NAMES_THREADS)


def tells_ekf(binary: Binary) -> bool:
    """Return whether a build says that its filter's failsafe acts, and when that is over; 4.1-dev does not."""
    return _holds(binary, _TELLS_EKF)


@cache
def _holds(binary: Binary, words: bytes) -> bool:
    with binary.path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        return content.find(words) >= 0


BINARIES = Binaries(AUTOPILOT, "ArduPilot", "SAFLITE_ARDUPILOT", WANTED, _inspected)
