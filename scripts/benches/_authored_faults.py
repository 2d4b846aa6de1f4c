"""Faults written by hand for measurements alone (`data/authored_faults.toml`): one line of one function replaced.

They are no part of the product, and no list, policy or default of it knows them.
"""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import NamedTuple

FILE = Path(__file__).parent / "data" / "authored_faults.toml"
PACKAGE = "saflite.flight.autopilots.reference"


class Patch(NamedTuple):
    """One fault: the text `old`, which stands once in a function, becomes `new`."""

    name: str
    module: str
    function: str
    old: str
    new: str


@cache
def authored() -> dict[str, Patch]:
    """Return the faults by name."""
    table = tomllib.loads(FILE.read_text(encoding="utf-8"))
    return {
        name: Patch(name, f"{PACKAGE}.{row['file'].replace('/', '.')}", row["function"], row["old"], row["new"])
        for name, row in table.items()
    }
