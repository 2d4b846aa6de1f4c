"""The build of a target that is part of this package: a digest of all code and libraries that shape its traces."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

FLIGHT = Path(__file__).resolve().parent
SUFFIXES = frozenset({".py", ".c", ".h", ".xml"})
BESIDE_THE_FLIGHT = frozenset({"competition", "logs", "mavlink", "missions"})
"""What reads or writes what was flown: no trace depends on it, but for autopilots that are driven by it (`parts`)."""

AUTOPILOTS = "autopilots"


@cache
def build_of(autopilot: str, libraries: tuple[str, ...] = ("jsbsim", "numpy"), parts: tuple[str, ...] = ()) -> str:
    """Return the digest of an autopilot of this package: its sources, those of the world, versions of libraries.

    `parts` are further packages that it is made of: of `autopilots`, or of those beside the flight. The same on every
    machine: compiled code counts by its source.
    """
    found = hashlib.sha256()
    for path in sorted(_sources((autopilot, *parts))):
        found.update(path.relative_to(FLIGHT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    for library in libraries:
        found.update(f"{library} {library_version(library)}\0".encode())
    return found.hexdigest()


def library_version(name: str) -> str:
    """Return the version of an installed package, empty if it is not installed."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _sources(packages: tuple[str, ...]) -> Iterator[Path]:
    for path in FLIGHT.rglob("*"):
        parts = path.relative_to(FLIGHT).parts
        of_another = parts[0] == AUTOPILOTS and len(parts) > 2 and parts[1] not in packages
        beside = parts[0] in BESIDE_THE_FLIGHT and parts[0] not in packages
        if path.suffix in SUFFIXES and not (beside or of_another):
            yield path
