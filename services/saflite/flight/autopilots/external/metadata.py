"""Ranges, units and meanings of parameters, where the autopilot's own metadata lies beside a binary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from saflite.contract import wire


class Documented(NamedTuple):
    """What the metadata says of one parameter."""

    low: float | None = None
    high: float | None = None
    unit: str = ""
    meaning: str = ""
    choices: tuple[float, ...] = ()


Rows = Callable[[Any], Mapping[str, Documented]]


def documented(path: Path, rows: Rows) -> Mapping[str, Documented]:
    """Return what a JSON file says, by name; nothing where there is none that can be read.

    Args:
        path: the file.
        rows: takes its content apart; whatever does not fit raises KeyError, TypeError or ValueError.
    """
    try:
        return _read(path, path.stat().st_mtime_ns, rows)
    except OSError:
        return {}


@cache
def _read(path: Path, changed_ns: int, rows: Rows) -> Mapping[str, Documented]:
    try:
        return rows(wire.unpack_json(path.read_bytes(), Any))
    except (*wire.UNREADABLE, KeyError, TypeError, ValueError, AttributeError):
        return {}
