"""Ranges, units and meanings of parameters, where the `parameters.json` of its build lies beside PX4's folder `bin`."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

FILE = "parameters.json"


class Documented(NamedTuple):
    """What the metadata says of one parameter."""

    low: float | None = None
    high: float | None = None
    unit: str = ""
    meaning: str = ""
    choices: tuple[float, ...] = ()


def documented(binary: Path) -> dict[str, Documented]:
    """Return what the metadata of a build says, by name; nothing where there is none that can be read."""
    path = binary.parent.parent / FILE
    try:
        return _read(path, path.stat().st_mtime_ns)
    except OSError:
        return {}


@cache
def _read(path: Path, changed_ns: int) -> dict[str, Documented]:
    try:
        rows = msgspec.json.decode(path.read_bytes())["parameters"]
        return {str(row["name"]): _row(row) for row in rows}
    except (msgspec.DecodeError, KeyError, TypeError, ValueError):
        return {}


def _row(row: dict[str, Any]) -> Documented:
    low, high = (None if row.get(key) is None else float(row[key]) for key in ("min", "max"))
    choices = tuple(sorted(float(one["value"]) for one in row.get("values", ())))
    return Documented(low, high, str(row.get("units", "")), str(row.get("shortDesc", ""))[:200], choices)
