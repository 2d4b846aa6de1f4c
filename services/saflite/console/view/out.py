"""The only place that writes to the terminal: lines, tables, JSON for scripts, complaints on stderr."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


def line(text: str = "") -> None:
    """Write one line of text."""
    sys.stdout.write(text + "\n")


def flush() -> None:
    """Hand what was written to whoever reads it."""
    sys.stdout.flush()


def complain(kind: str, text: str) -> None:
    """Write one line to stderr; line breaks inside `text` are folded."""
    sys.stdout.flush()
    sys.stderr.write(f"saflite: {kind}: {' '.join(text.split())}\n")


def json(value: Any) -> None:
    """Write `value` (structs, mappings, numbers; bytes become base64) as one line of JSON."""
    import msgspec

    sys.stdout.write(msgspec.json.encode(value, order="deterministic").decode() + "\n")
    sys.stdout.flush()


def table(rows: Iterable[Sequence[object]], headers: Sequence[str] = (), indent: str = "") -> None:
    """Write rows in columns as wide as their widest cell; the last column is left ragged."""
    cells = [[str(cell) for cell in row] for row in rows]
    if headers:
        cells.insert(0, [str(head) for head in headers])
    if not cells:
        return
    widths = [max(len(row[column]) for row in cells if column < len(row)) for column in range(max(map(len, cells)))]
    for row in cells:
        padded = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        line(indent + "  ".join(padded).rstrip())


def summary_of(path: Path) -> str:
    """Return the first line of a Python file's docstring without importing it; empty if there is none."""
    with path.open(encoding="utf-8") as file:
        first = file.readline().strip()
    return first.strip('"').strip() if first.startswith('"""') else ""


def mute() -> None:
    """Stop writing for good: the reader of our output has gone."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
