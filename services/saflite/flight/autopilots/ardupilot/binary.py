"""Which binary flies: the one a person names. It is known by its content; its path goes nowhere.

The autopilot is an external program under the GPL-3; nothing of it is part of this package.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from saflite.contract.config import environment, set_environment
from saflite.contract.errors import Refused, Unavailable
from saflite.flight.autopilots.external.elf import check_program

AUTOPILOT = "ardupilot"
PLACE = "SAFLITE_ARDUPILOT"
HOW_TO_NAME = f"name its simulator build: --autopilot PATH or {PLACE}=PATH"
WANTED = "name a build of ArduCopter for its simulator (SITL)"
VEHICLES = ("ArduCopter", "ArduPlane", "ArduRover", "Rover", "ArduSub", "AntennaTracker", "Blimp")
_VERSION = re.compile(rb"\0((?:" + "|".join(VEHICLES).encode() + rb") V\d[\w.\- ]*)")
_PX4 = b"px4_daemon"
_BACKEND = b"JSON control interface set to"


class Binary(NamedTuple):
    """A binary that can fly here; `version` is the line it says at its start."""

    path: Path
    digest: str
    version: str


def use(path: Path) -> None:
    """Have this process and those it starts fly with the binary in `path`; raises Refused as `inspect`."""
    inspect(path)
    set_environment(PLACE, str(path.resolve()))


def named() -> Binary:
    """Return the binary named for this process.

    Raises:
        Unavailable: none is named, or it is gone.
        Refused: it cannot fly; see `inspect`.
    """
    place = environment(PLACE)
    if not place:
        raise Unavailable(f"no ArduPilot binary is named; {HOW_TO_NAME}")
    if not Path(place).is_file():
        raise Unavailable(f"{PLACE}: no file at {place}; {HOW_TO_NAME}")
    return inspect(Path(place))


def inspect(path: Path) -> Binary:
    """Return what a file is, without running it.

    Raises:
        Refused: no program, for another processor, no ArduPilot, another vehicle, or without the JSON backend.
    """
    try:
        state = path.stat()
        if not path.is_file() or state.st_size == 0:
            raise Refused("autopilot", where=str(path), expected="a program", got="no file with content")
        return _inspected(path, state.st_mtime_ns, state.st_size)
    except OSError as fault:
        raise Refused("autopilot", where=str(path), expected="a program", got=str(fault), fix=WANTED) from fault


@cache
def _inspected(path: Path, changed_ns: int, size: int) -> Binary:
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
        if not os.access(path, os.X_OK):
            raise Refused("autopilot", where=where, expected="leave to run it", got="none", fix=f"chmod +x {where}")
        return Binary(path, hashlib.sha256(content).hexdigest(), version)


def cache_folder() -> Path:
    """Return the folder of what this user's binaries said of themselves."""
    return Path(environment("SAFLITE_CACHE") or Path.home() / ".cache" / "saflite") / AUTOPILOT
