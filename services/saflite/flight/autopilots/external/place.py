"""Where a flight with an autopilot in another process may live on its host."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple


class Place(NamedTuple):
    """Where a flight may live on its host: a folder of its own, ports nobody else binds."""

    folder: Path
    ports: range


@contextmanager
def one_core(place: Place) -> Iterator[None]:
    """Keep this process and what it starts on one core, where two links deliver in the order they were written to.

    Across cores a word on one link may overtake an earlier one on the other, and each takes longer.
    """
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(before)[place.ports[0] // max(1, len(place.ports)) % len(before)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class FailedBringUp(Exception):
    """The autopilot ended before it answered; says how."""
