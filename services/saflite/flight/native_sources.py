"""Which sources the compiled library is made of. Standard library only: the build script loads this file by path."""

from __future__ import annotations

import hashlib
from pathlib import Path

FLIGHT = Path(__file__).resolve().parent
DIGEST_HEX = 32


def sources(ending: str) -> list[Path]:
    """Return the files of every `native` folder whose names end so, in order."""
    return sorted(FLIGHT.rglob(f"native/*.{ending}"))


def digest() -> str:
    """Return the digest of all sources and headers; built into the library, so that a stale one shows."""
    found = hashlib.sha256()
    for path in sources("[ch]"):
        found.update(path.relative_to(FLIGHT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()[:DIGEST_HEX]
