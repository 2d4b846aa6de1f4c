"""The page deploy/docs/books.md: the words of `pages/books.md` with the figures of the newest row of each length."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from string import Template

import msgspec
from _markdown import table

HERE = Path(__file__).resolve().parent
TEMPLATE = HERE / "pages" / "books.md"
LENGTHS = (1_000, 10_000, 100_000)
NEAR = 0.05  # a run ends with the round it is in


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One run; older rows lack what was not measured then."""

    commit: str
    flights: int = 0
    note: str = ""
    memory_begun_mib: float = 0.0
    memory_peak_mib: float = 0.0
    database_mb: float = 0.0
    database_kb_per_flight: float = 0.0
    snapshot_mb: float = 0.0
    resume_s: float = 0.0
    resume_cpu_s: float = 0.0
    killed_s: float = 0.0
    killed_cpu_s: float = 0.0
    killed_lines_behind: int = 0
    replay_s: float = 0.0
    replay_cpu_s: float = 0.0
    replay_lines_behind: int = 0


def rows(path: Path) -> list[Row]:
    """Return the rows of a file."""
    return [msgspec.json.decode(line, type=Row) for line in path.read_bytes().splitlines() if line.strip()]


def newest(found: Sequence[Row]) -> list[Row]:
    """Return the last row of each length that was measured with a kill."""
    whole = [row for row in found if row.killed_cpu_s]
    near = [[row for row in whole if abs(row.flights - length) <= NEAR * length] for length in LENGTHS]
    return [several[-1] for several in near if several]


def page(found: Sequence[Row]) -> str:
    """Return the page in Markdown."""
    shown = newest(found)
    sizes = table(
        (
            "flights",
            "memory at the start, MiB",
            "at most, MiB",
            "store, MB",
            "store a flight, KB",
            "snapshot, MB",
            "commit",
        ),
        [
            (
                f"{row.flights:,}",
                *(f"{row.memory_begun_mib:.0f}", f"{row.memory_peak_mib:.1f}", f"{row.database_mb:.1f}"),
                *(f"{row.database_kb_per_flight:.2f}", f"{row.snapshot_mb:.2f}", f"`{row.commit}`"),
            )
            for row in shown
        ],
    )
    times = table(
        (
            "flights",
            "closed, s (wall)",
            "killed, s (wall)",
            "entries behind",
            "without a snapshot, s (wall)",
            "entries",
        ),
        [
            (
                f"{row.flights:,}",
                f"{row.resume_cpu_s:.2f} ({row.resume_s:.1f})",
                *(f"{row.killed_cpu_s:.2f} ({row.killed_s:.1f})", f"{row.killed_lines_behind:,}"),
                *(f"{row.replay_cpu_s:.1f} ({row.replay_s:.0f})", f"{row.replay_lines_behind:,}"),
            )
            for row in shown
        ],
    )
    notes = "; ".join(dict.fromkeys(row.note for row in shown))
    return Template(TEMPLATE.read_text()).substitute(sizes=sizes, times=times, notes=notes)
