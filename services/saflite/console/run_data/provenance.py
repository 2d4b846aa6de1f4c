"""What code flew: noted in the run folder, so that a replay that differs can say whether the code does."""

from __future__ import annotations

import platform
from pathlib import Path

import msgspec

from saflite.contract.bounds import Word
from saflite.contract.errors import FarmError, Unavailable
from saflite.contract.names import Name
from saflite.contract.outside import TEXT_BYTES_MAX, read_bytes
from saflite.contract.target_info import TargetInfo
from saflite.contract.wire import UNREADABLE, unpack_json
from saflite.flight.build import library_version

FILE = "software.json"


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """Versions, and the build of the target that flew: all code that shapes a trace."""

    saflite: Word
    target: Name
    build: Word
    jsbsim: Word
    numpy: Word
    python: Word
    machine: Word


def here(target: TargetInfo) -> Provenance:
    """Return the software of this installation, for a target."""
    return Provenance(
        saflite=library_version("saflite-farm"),
        target=target.name,
        build=target.build,
        jsbsim=library_version("jsbsim"),
        numpy=library_version("numpy"),
        python=platform.python_version(),
        machine=platform.machine(),
    )


def note(run_dir: Path, target: TargetInfo) -> None:
    """Leave the software of this installation in a run folder."""
    try:
        (run_dir / FILE).write_bytes(msgspec.json.format(msgspec.json.encode(here(target))) + b"\n")
    except OSError as fault:
        raise Unavailable(f"{run_dir}: {fault}") from fault


def read(run_dir: Path) -> Provenance | None:
    """Return the software noted in a run folder; None if there is none or the note is damaged."""
    try:
        return unpack_json(read_bytes(run_dir / FILE, FILE, TEXT_BYTES_MAX), Provenance)
    except (*UNREADABLE, FarmError):
        return None


def differs(run_dir: Path) -> str:
    """Return in words how the software that flew a run differs from this one; empty if it does not or is not known."""
    from saflite.simulator_worker.registry import describe_target

    then = read(run_dir)
    if then is None:
        return ""
    try:
        now = here(describe_target(then.target))
    except FarmError:
        return ""
    parts = [
        f"{name} {getattr(then, name)[:12]} then, {getattr(now, name)[:12]} now"
        for name in ("build", "jsbsim", "numpy", "machine")
        if getattr(then, name) != getattr(now, name)
    ]
    return "; ".join(parts)
