"""Where a flight with an autopilot in another process may live on its host."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple


class Place(NamedTuple):
    """Where a flight may live on its host: a folder of its own, ports nobody else binds.

    A process started there ends at the age of `age_max_s`, 0 for none: where no sandbox watches it.
    """

    folder: Path
    ports: range
    age_max_s: float = 0.0


_OUTSIDE = ("/tmp/px4-sock-", "/tmp/px4_lock-")  # noqa: S108  (PX4 has no other place for them)


def outside(first_port: int) -> tuple[Path, ...]:
    """Return the files that an autopilot keeps where all users' lie, named after the first port of its place."""
    return tuple(Path(f"{name}{first_port}") for name in _OUTSIDE)


def left_outside() -> Iterator[tuple[int, Path]]:
    """Yield the files there are of this kind, of living and dead, each with the first port of its place."""
    for name in _OUTSIDE:
        for path in Path(name).parent.glob(f"{Path(name).name}*"):
            number = path.name.removeprefix(Path(name).name)
            if number.isdecimal():
                yield int(number), path


@contextmanager
def one_core(place: Place) -> Iterator[None]:
    """Keep this process and what it starts on one core, where two links deliver in the order they were written to.

    Across cores a word on one link may overtake an earlier one on the other, and each takes longer.
    """
    before = os.sched_getaffinity(0)
    stay_on_one_core(place)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def stay_on_one_core(place: Place) -> None:
    """The same for a process that does nothing else."""
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[place.ports[0] // max(1, len(place.ports)) % len(cores)]})


class FailedBringUp(Exception):
    """The autopilot ended before it answered; says how."""
