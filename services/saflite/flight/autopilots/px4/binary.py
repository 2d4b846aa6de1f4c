"""Which binary flies: the one a person names, with the start-up files beside it. Known by content; paths go nowhere.

The autopilot is an external program; nothing of it is part of this package.
"""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from saflite.contract.errors import Refused
from saflite.flight.autopilots.external.binary import PROGRAM_BYTES_MAX, Binaries, Binary, check_runnable
from saflite.flight.autopilots.external.elf import check_program

AUTOPILOT = "px4"
WANTED = "name the program bin/px4 of a build of PX4 for its simulator (px4_sitl)"
START_UP = "init.d-posix"
RCS = f"{START_UP}/rcS"
AIRFRAME, OWN_AIRFRAME = "10016_none_iris", "10040_sihsim_quadx"
ALIASES = "px4-alias.sh"
_MARK = b"px4_daemon"
_SIMULATOR = b"HIL_ACTUATOR_CONTROLS", b"simulator_mavlink"


def start_up_of(path: Path) -> Path:
    """Return the folder of a binary's start-up files."""
    return path.parent.parent / "etc"


def is_px4(path: Path) -> bool:
    """Return whether a file is a program that says it is PX4."""
    try:
        return path.is_file() and path.stat().st_size <= PROGRAM_BYTES_MAX and _MARK in path.read_bytes()
    except OSError:
        return False


@cache
def _inspected(path: Path, state: int) -> Binary:
    content, where = path.read_bytes(), str(path)
    check_program(content[:20], where, WANTED)
    if _MARK not in content:
        raise Refused("autopilot", where=where, expected="PX4", got="a program without PX4's words", fix=WANTED)
    if _SIMULATOR[1] not in content:
        expected = "a build for the simulator with simulator_mavlink"
        raise Refused("autopilot", where=where, expected=expected, got="PX4 without it", fix=WANTED)
    check_runnable(path)
    start_up = start_up_of(path)
    for needed in (start_up / RCS, start_up / START_UP / "airframes" / AIRFRAME, path.parent / ALIASES):
        if not needed.is_file():
            fix = "leave bin/px4 in its build folder, with etc/ beside bin/"
            raise Refused("autopilot", where=where, expected=f"{needed} of its build", got="no file", fix=fix)
    return Binary(path, _digest(content, path), "PX4")


def _start_up_files(path: Path) -> list[Path]:
    return sorted(one for one in start_up_of(path).rglob("*") if one.is_file())


def _files(path: Path) -> list[Path]:
    return [path, *_start_up_files(path)]


def _digest(content: bytes, program: Path) -> str:
    found = hashlib.sha256(hashlib.sha256(content).digest())
    for path in _start_up_files(program):
        found.update(path.relative_to(start_up_of(program)).as_posix().encode() + b"\0")
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


BINARIES = Binaries(AUTOPILOT, "PX4", "SAFLITE_PX4", WANTED, _inspected, _files)
