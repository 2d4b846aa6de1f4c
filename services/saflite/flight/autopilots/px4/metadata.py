"""Ranges, units and meanings of parameters, where the `parameters.json` of its build lies beside PX4's folder `bin`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from saflite.flight.autopilots.external import metadata
from saflite.flight.autopilots.external.metadata import Documented

FILE = "parameters.json"


def documented(binary: Path) -> Mapping[str, Documented]:
    """Return what the metadata of a build says, by name; nothing where there is none that can be read."""
    return metadata.documented(binary.parent.parent / FILE, _rows)


def _rows(content: Any) -> dict[str, Documented]:
    return {str(row["name"]): _row(row) for row in content["parameters"]}


def _row(row: dict[str, Any]) -> Documented:
    low, high = (None if row.get(key) is None else float(row[key]) for key in ("min", "max"))
    choices = tuple(sorted(float(one["value"]) for one in row.get("values", ())))
    return Documented(low, high, str(row.get("units", "")), str(row.get("shortDesc", ""))[:200], choices)
