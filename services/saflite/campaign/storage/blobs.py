"""Traces as files named by the digest of their content: written beside, then renamed.

Only traces that are kept are flushed. The others are needed until they are judged; one that a power failure takes is
noticed by its digest when the books are opened, and flown again.
"""

from __future__ import annotations

import os
from pathlib import Path

from saflite.contract.errors import Unavailable
from saflite.contract.flight import matches_digest


class TraceFiles:
    """The folder of traces of one run."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def path(self, digest: str) -> Path:
        """Return where a trace stands."""
        return self._folder / f"{digest}.trace"

    def write(self, traces: dict[str, bytes]) -> None:
        """Write traces, not yet flushed; raises Unavailable if the disk takes no more."""
        beside = self._folder / "none.part"
        try:
            for digest, data in traces.items():
                target = self.path(digest)
                if not target.exists():
                    beside = target.with_suffix(".part")
                    beside.write_bytes(data)
                    beside.rename(target)
        except OSError as fault:
            beside.unlink(missing_ok=True)
            raise Unavailable(f"traces cannot be written to {self._folder}: {fault}") from fault

    def flush(self, digests: tuple[str, ...]) -> None:
        """Have traces that are to be kept on disk for good; raises Unavailable if the disk fails."""
        try:
            for path in (self.path(digest) for digest in digests):
                if path.exists():
                    _flush(path)
            if digests:
                _flush(self._folder)
        except OSError as fault:
            raise Unavailable(f"traces in {self._folder} cannot be flushed: {fault}") from fault

    def drop(self, digests: tuple[str, ...]) -> None:
        """Remove traces nobody needs any more."""
        for digest in digests:
            self.path(digest).unlink(missing_ok=True)

    def read(self, digest: str) -> bytes | None:
        """Return a packed trace as it stands, None if it is not there."""
        try:
            return self.path(digest).read_bytes()
        except OSError:
            return None

    def read_checked(self, digest: str) -> bytes | None:
        """Return a packed trace whose content fits its digest, None if it is missing or damaged."""
        data = self.read(digest)
        return data if data is not None and matches_digest(data, digest) else None

    def digests(self) -> list[str]:
        """Return the digests of all traces there, sorted."""
        return sorted(path.stem for path in self._folder.glob("*.trace"))

    def keep_only(self, wanted: frozenset[str]) -> None:
        """Remove what an interrupted write or commit left behind."""
        for path in self._folder.iterdir():
            if path.suffix == ".part" or (path.suffix == ".trace" and path.stem not in wanted):
                path.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
