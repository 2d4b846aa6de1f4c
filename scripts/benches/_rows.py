"""Rows of a measurement: kept in a file of JSON lines, printed for scripts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def handed_out(rows: Sequence[dict[str, Any]], out: Path | None, *, as_json: bool) -> bool:
    """Add the rows to a file if one is named, print them `as_json`; return whether nothing is left to print."""
    if out is not None:
        with out.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
    if as_json:
        print(json.dumps(rows, indent=2))
    return as_json
