"""What code flew: noted in the run folder, so that a replay that differs can say whether the code does."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

from saflite.contract.errors import Unavailable

FILE = "software.json"
_FLIGHT_CODE = ("*.py", "*.c", "*.h", "*.xml", "*.plan")


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """Versions and the digest of all code that shapes a trace."""

    saflite: str
    flight_code: str
    jsbsim: str
    numpy: str
    python: str
    machine: str


def here() -> Provenance:
    """Return the software of this installation."""
    return Provenance(
        saflite=_version("saflite-farm"),
        flight_code=_flight_code(),
        jsbsim=_version("jsbsim"),
        numpy=_version("numpy"),
        python=platform.python_version(),
        machine=platform.machine(),
    )


def note(run_dir: Path) -> None:
    """Leave the software of this installation in a run folder."""
    try:
        (run_dir / FILE).write_bytes(msgspec.json.format(msgspec.json.encode(here())) + b"\n")
    except OSError as fault:
        raise Unavailable(f"{run_dir}: {fault}") from fault


def differs(run_dir: Path) -> str:
    """Return in words how the software that flew a run differs from this one; empty if it does not or is not known."""
    try:
        then = msgspec.json.decode((run_dir / FILE).read_bytes(), type=Provenance)
    except (OSError, msgspec.MsgspecError):
        return ""
    now = here()
    parts = [
        f"{name} {getattr(then, name)[:12]} then, {getattr(now, name)[:12]} now"
        for name in ("flight_code", "jsbsim", "machine")
        if getattr(then, name) != getattr(now, name)
    ]
    return "; ".join(parts)


def _flight_code() -> str:
    package = Path(__file__).resolve().parents[2]
    found = hashlib.sha256()
    for folder in (package / "flight", package / "simulator_worker" / "targets"):
        for path in sorted(path for pattern in _FLIGHT_CODE for path in folder.rglob(pattern)):
            found.update(str(path.relative_to(package)).encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
