"""Files from outside, made wrong and handed to the commands' own readers: refused in words, or taken; nothing else.

A file that takes more than `CPU_S` of processor time or more than `MEMORY_MB` of memory is a failure, too.
"""

from __future__ import annotations

import contextlib
import io
import resource
import shutil
import signal
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from copy import deepcopy
from functools import cache, lru_cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from file_kinds import ALL, FileKind
from file_mutations import wrong

from saflite.contract.errors import Refused, Unavailable

KINDS: dict[str, FileKind] = {kind.name: kind for kind in ALL}
CORPUS = Path(__file__).resolve().parents[2] / "tests" / "corpus" / "files"
SHM = Path("/dev/shm")
"""Where a folder is removed in microseconds; on a disk that takes longer than most files do."""
if SHM.is_dir():
    tempfile.tempdir = str(SHM)

CPU_S = 30.0
MEMORY_MB = 700


_loads = lru_cache(8)(tomllib.loads)


def _loads_once(text: str) -> dict[str, Any]:
    """As `tomllib.loads`: readers of one command parse the same text up to four times."""
    return deepcopy(_loads(text))


tomllib.loads = _loads_once  # type: ignore[assignment]


class TooMuch(Exception):
    """A file took more processor time or memory than any may."""


class Files:
    """Files of one kind."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self.kind, self.rng, self.number = KINDS[kind], rng, 0
        self._folder = Path(tempfile.mkdtemp(prefix="saflite-fuzz-", dir=SHM if SHM.is_dir() else None))
        self.last = b""

    def step(self) -> int:
        """Hand in one wrong file; returns 1. Raises what a command would end in."""
        self.number += 1
        valid = _valid(self.kind.name)
        data = valid[self.number % len(valid)]
        make = self.kind.made_wrong
        self.take(make(data, self.rng) if make is not None else wrong(data, self.kind.language, self.rng))
        return 1

    def take(self, data: bytes) -> None:
        """Hand in a file of this content."""
        self.last = data
        folder = self._folder / "in"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        path = folder / self.kind.name
        path.write_bytes(data)
        path.chmod(0o600)  # secrets are read of no other file
        path.chmod(0o600)
        silent = contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO())
        with suppress(Refused, Unavailable), silent[0], silent[1], _bounded():
            self.kind.use(path)

    def close(self) -> None:
        """Leave nothing behind."""
        shutil.rmtree(self._folder, ignore_errors=True)


@cache
def _valid(kind: str) -> tuple[bytes, ...]:
    """Return the valid files of a kind."""
    found = tuple(KINDS[kind].valid())
    assert found, kind
    return found


def kept() -> Iterator[tuple[str, Path]]:
    """Yield the files of the corpus: those that broke something once, by kind."""
    for kind in KINDS:
        folder = CORPUS / kind
        yield from ((kind, path) for path in sorted(folder.glob("*")) if path.is_file())


@contextmanager
def _bounded() -> Iterator[None]:
    """Raise `TooMuch` inside, or at the end, of what takes too much."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooMuch(f"more than {CPU_S:.0f} s of processor time")

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    earlier = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, earlier)
        grown_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
        if grown_mb > MEMORY_MB:
            raise TooMuch(f"{grown_mb:.0f} MB of memory more than before")
