"""Where a farm saturates, computed from measured costs: the table of deploy/docs/scale.md."""

from __future__ import annotations

import json
from pathlib import Path

ROWS = Path(__file__).parent / "results" / "books.jsonl"
BUS_RESULTS_PER_S, BUS_CORE_SHARE = (
    330.0,
    0.73,
)  # `scripts/bench bus`, 1,000 workers polling
TRACE_KB = 100.0  # a packed trace of a flight of about a minute
SIMULATORS = (10, 100, 1_000, 10_000)
PACES = (("in real time, 60 s a flight", 60.0), ("on the reference, 1.3 s a flight", 1.3))


def table() -> str:
    """Return the table as Markdown."""
    rows = [json.loads(line) for line in ROWS.read_text().splitlines()]
    row = [one for one in rows if "results" in one][-1]  # the latest
    results = row["results"] / row["flights"]
    core_s = results * BUS_CORE_SHARE / BUS_RESULTS_PER_S
    lines = [
        f"Results a flight {results:.1f}; core time of the books {1000 * core_s:.1f} ms a flight; journal "
        f"{row['database_kb_per_flight']:.1f} KB and trace {TRACE_KB:.0f} KB a flight.",
        "",
        "| simulators | pace | flights a second | cores of the books | journal, GB a day | traces over the bus, MB/s |",
        "|---|---|---|---|---|---|",
    ]
    for pace, flight_s in PACES:
        for count in SIMULATORS:
            rate = count / flight_s
            journal = rate * row["database_kb_per_flight"] * 86_400 / 1e6
            share, traces = rate * core_s, rate * TRACE_KB / 1e3
            lines.append(f"| {count:,} | {pace} | {rate:,.1f} | {share:,.2f} | {journal:,.1f} | {traces:,.1f} |")
    return "\n".join(lines)
