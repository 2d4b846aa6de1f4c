"""What code a worker runs: a digest of what decides its stage's answers, so that two machines can be compared."""

from __future__ import annotations

import hashlib
import os
import socket
from functools import cache
from pathlib import Path

from saflite.contract.clock import Clock
from saflite.contract.ids import short_id
from saflite.contract.join import Join
from saflite.contract.modules import all_given
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Stage, TargetBuild
from saflite.flight.build import library_version

PACKAGE = Path(__file__).resolve().parents[1]
SUFFIXES = frozenset({".py", ".c", ".h", ".xml", ".plan", ".toml", ".json"})
CODE: dict[Stage, tuple[str, ...]] = {
    "mutate": ("contract", "flight", "mutator"),
    "score": ("contract", "flight", "oracle", "scorer_pool"),
    "fly": ("contract", "flight", "simulator_worker"),
    "judge": ("contract", "flight", "oracle"),
    "record": ("contract", "recorder"),
}
"""The rooms of this package whose code decides what a stage answers."""

LIBRARIES = ("jsbsim", "msgspec", "numpy", "scikit-learn")


@cache
def version() -> str:
    """Return the version of this package."""
    return library_version("saflite-farm")


@cache
def software_of(stage: Stage) -> str:
    """Return the digest of the code of a stage and of the libraries it computes with; the same on every machine."""
    found = hashlib.sha256()
    for room in CODE[stage]:
        for path in sorted(path for path in (PACKAGE / room).rglob("*") if path.suffix in SUFFIXES):
            found.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    for library in LIBRARIES:
        found.update(f"{library} {library_version(library)}\0".encode())
    return found.hexdigest()


def gpus() -> int:
    """Return how many GPUs this process can open: NVIDIA's devices, else render nodes of other makers."""
    return len([*Path("/dev").glob("nvidia[0-9]*")] or [*Path("/dev/dri").glob("renderD*")])


def card_of(
    stage: Stage,
    worker: str,
    clock: Clock,
    *,
    targets: tuple[TargetBuild, ...] = (),
    labels: dict[str, str] | None = None,
) -> Join:
    """Return what a worker of this process says of itself when it joins."""
    host = socket.gethostname()
    return Join(
        protocol=PROTOCOL,
        worker=worker,
        session=short_id(f"{host} {os.getpid()} {worker} {clock.unix_s()!r}".encode()),
        stage=stage,
        version=version(),
        software=software_of(stage),
        targets=targets,
        modules={module.key: module.digest for module in all_given()},
        host=host,
        cores=len(os.sched_getaffinity(0)),
        gpus=gpus(),
        labels=labels or {},
    )
