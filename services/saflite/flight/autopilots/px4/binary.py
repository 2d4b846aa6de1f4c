"""Which binary flies: the one a person names, with the start-up files beside it. Known by content; paths go nowhere.

The autopilot is an external program; nothing of it is part of this package.
"""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path
from typing import NamedTuple

from saflite.contract.config import environment, set_environment
from saflite.contract.errors import Refused, Unavailable
from saflite.flight.autopilots.external.elf import check_program

AUTOPILOT = "px4"
PLACE = "SAFLITE_PX4"
HOW_TO_NAME = f"name its simulator build: --autopilot PATH or {PLACE}=PATH"
WANTED = "name the program bin/px4 of a build of PX4 for its simulator (px4_sitl)"
START_UP = "init.d-posix"
RCS = f"{START_UP}/rcS"
AIRFRAME = "10016_none_iris"
ALIASES = "px4-alias.sh"
_MARK = b"px4_daemon"
_SIMULATOR = b"HIL_ACTUATOR_CONTROLS", b"simulator_mavlink"


class Binary(NamedTuple):
    """A binary that can fly here; `digest` is of the program and its start-up files."""

    path: Path
    digest: str
    version: str

    @property
    def start_up(self) -> Path:
        """The folder of its start-up files."""
        return self.path.parent.parent / "etc"


def is_px4(path: Path) -> bool:
    """Return whether a file is a program that says it is PX4."""
    try:
        return path.is_file() and _MARK in path.read_bytes()
    except OSError:
        return False


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
        raise Unavailable(f"no PX4 binary is named; {HOW_TO_NAME}")
    if not Path(place).is_file():
        raise Unavailable(f"{PLACE}: no file at {place}; {HOW_TO_NAME}")
    return inspect(Path(place))


def inspect(path: Path) -> Binary:
    """Return what a file is, without running it.

    Raises:
        Refused: no program, for another processor, no PX4, without the simulator's MAVLink interface, or without its
            start-up files.
    """
    try:
        path = path.resolve()
        if not path.is_file() or path.stat().st_size == 0:
            raise Refused("autopilot", where=str(path), expected="a program", got="no file with content")
        return _inspected(path, path.stat().st_mtime_ns)
    except OSError as fault:
        raise Refused("autopilot", where=str(path), expected="a program", got=str(fault), fix=WANTED) from fault


@cache
def _inspected(path: Path, changed_ns: int) -> Binary:
    content, where = path.read_bytes(), str(path)
    check_program(content[:20], where, WANTED)
    if _MARK not in content:
        raise Refused("autopilot", where=where, expected="PX4", got="a program without PX4's words", fix=WANTED)
    if _SIMULATOR[1] not in content:
        expected = "a build for the simulator with simulator_mavlink"
        raise Refused("autopilot", where=where, expected=expected, got="PX4 without it", fix=WANTED)
    if not os.access(path, os.X_OK):
        raise Refused("autopilot", where=where, expected="leave to run it", got="none", fix=f"chmod +x {where}")
    start_up = path.parent.parent / "etc"
    for needed in (start_up / RCS, start_up / START_UP / "airframes" / AIRFRAME, path.parent / ALIASES):
        if not needed.is_file():
            fix = "leave bin/px4 in its build folder, with etc/ beside bin/"
            raise Refused("autopilot", where=where, expected=f"{needed} of its build", got="no file", fix=fix)
    return Binary(path, _digest(content, start_up), "PX4")


def _digest(content: bytes, start_up: Path) -> str:
    found = hashlib.sha256(hashlib.sha256(content).digest())
    for path in sorted(path for path in start_up.rglob("*") if path.is_file()):
        found.update(path.relative_to(start_up).as_posix().encode() + b"\0")
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def cache_folder() -> Path:
    """Return the folder of what this user's binaries said of themselves."""
    return Path(environment("SAFLITE_CACHE") or Path.home() / ".cache" / "saflite") / AUTOPILOT
