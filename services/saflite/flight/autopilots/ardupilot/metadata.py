"""Ranges, units and meanings of parameters, where ArduPilot's own metadata lies beside the binary.

`apm.pdef.json`, as ArduPilot's `param_parse.py` writes it: groups of parameters, each with Range, Units, Values or
Bitmask. A mask whose bits are all documented is a range of whole numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from saflite.flight.autopilots.external import metadata
from saflite.flight.autopilots.external.metadata import Documented

FILE = "apm.pdef.json"
FLOAT_BITS = 24


def documented(binary: Path) -> Mapping[str, Documented]:
    """Return what the metadata beside a binary says, by name; nothing where there is none that can be read."""
    return metadata.documented(binary.parent / FILE, _rows)


def _rows(groups: Any) -> dict[str, Documented]:
    found = (rows for rows in groups.values() if isinstance(rows, dict))
    return {name: _row(row) for group in found for name, row in group.items() if isinstance(row, dict)}


def _row(row: dict[str, Any]) -> Documented:
    limits = row.get("Range")
    low, high = (_number(limits.get("low")), _number(limits.get("high"))) if isinstance(limits, dict) else (None, None)
    if low is None and high is None:
        low, high = _mask(row.get("Bitmask"))
    values = row.get("Values")
    numbers = [_number(value) for value in values] if isinstance(values, dict) else []
    choices = tuple(sorted(value for value in numbers if value is not None))
    return Documented(low, high, str(row.get("Units", "")), str(row.get("DisplayName", ""))[:200], choices)


def _mask(bits: object) -> tuple[float | None, float | None]:
    """Return 0 and the sum of all bits where none is left out and a MAVLink parameter (a 32-bit float) holds them."""
    places = sorted(int(bit) for bit in bits if str(bit).isdecimal()) if isinstance(bits, dict) else []
    whole = places and places == list(range(len(places))) and len(places) <= FLOAT_BITS
    return (0.0, 2.0 ** len(places) - 1.0) if whole else (None, None)


def _number(text: object) -> float | None:
    try:
        return float(str(text))
    except ValueError:
        return None
