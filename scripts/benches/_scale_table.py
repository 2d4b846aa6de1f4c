"""The tables of deploy/docs/scale.md up to its books' loop: rows of `scripts/bench scale` and `scripts/bench books`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from saflite.campaign.scheduling.leases import BEATS_PER_S_MAX
from saflite.contract.config import LeaseConfig
from saflite.contract.work import BEATS_PER_LEASE

LEASE_S = LeaseConfig().lease_s
RESULTS = Path(__file__).parent / "results"
TRACE_KB = 45.0  # a packed trace a minute of flight: the median of seven of `policy-all`, 26 November 2026
SIMULATORS = (10, 100, 1_000, 10_000)
PACES = (("in real time, 60 s a flight", 60.0), ("on the reference, 1.3 s a flight", 1.3))

Row = dict[str, Any]


def tables() -> str:
    """Return all tables as Markdown."""
    rows = _rows("scale.jsonl")
    cells, outages = [row for row in rows if "outage" not in row], [row for row in rows if "outage" in row]
    journal_kb = [row for row in _rows("books.jsonl") if "results" in row][-1]["database_kb_per_flight"]  # the latest
    return "\n".join([*_cells(cells), "", *_outages(outages), "", *_saturation(cells, journal_kb)])


def _rows(name: str) -> list[Row]:
    return [json.loads(line) for line in (RESULTS / name).read_text().splitlines()]


def _cells(cells: list[Row]) -> Iterator[str]:
    yield (
        "| workers | nodes | link | a flight, s | machine | cells | efficiency | books, cores | books, ms a flight "
        "| events a flight | load |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for workers, link, machine in sorted({_kind(row) for row in cells}, key=lambda kind: (kind[2], *kind[:2])):
        of = [row for row in cells if _kind(row) == (workers, link, machine)]
        efficiency = _spread([100 * row["efficiency"] for row in of], "{:.1f} %")
        cost = _spread([row["books_ms_per_flight"] for row in of], "{:.1f}")
        cores, events = median(row["books_core_share"] for row in of), median(row["events_per_flight"] for row in of)
        load = _spread([row["load_1min"] for row in of], "{:.0f}")
        yield (
            f"| {workers} | {of[0]['nodes']} | {link} | {of[0]['think_s']:.0f} | {machine} | {len(of)} | {efficiency} "
            f"| {cores:.2f} | {cost} | {events:.1f} | {load} |"
        )
    yield ""
    for workers in sorted({row["workers"] for row in cells}):
        ratios = _overheads([row for row in cells if row["workers"] == workers])
        if ratios:
            cost = _spread([100 * (ratio - 1) for ratio in ratios], "{:+.0f} %")
            yield f"mTLS over plain TCP, time of the books a flight, pairs in turns at {workers} workers: {cost}."


def _kind(row: Row) -> tuple[int, str, str]:
    """Return workers, link, and what else the machine did: rows from before that was noted had other work beside."""
    return row["workers"], row["link"], row.get("machine", "shared")


def _overheads(cells: list[Row]) -> list[float]:
    """Return TLS over TCP of the cells that followed one another."""
    pairs = zip(cells[::2], cells[1::2], strict=False)
    links = [{row["link"]: row["books_ms_per_flight"] for row in pair} for pair in pairs]
    return [pair["tls"] / pair["tcp"] for pair in links if len(pair) == 2]


def _spread(values: list[float], form: str) -> str:
    """Return the median, and the least and the most of several."""
    middle = form.format(median(values))
    return middle if len(values) == 1 else f"{middle} ({form.format(min(values))} to {form.format(max(values))})"


def _outages(outages: list[Row]) -> Iterator[str]:
    yield "| outage | workers | lasted, s | next flight after, s | first flights | lost | double | flown anew |"
    yield "|---|---|---|---|---|---|---|---|"
    for row in outages:
        yield (
            f"| {row['outage']} | {row['workers']} on {row['nodes']} nodes | {row['outage_s']:.0f} "
            f"| {row['to_next_flight_s']:.1f} | {row['budget']} | {row['lost']} | {row['double']} "
            f"| {row['attempts_lost']} |"
        )


def _saturation(cells: list[Row], journal_kb: float) -> Iterator[str]:
    """Extrapolate what a flight and what a worker that is there cost the books, on the idle machine with keys."""
    with_keys = [row for row in cells if row.get("machine") == "idle" and row["link"] == "tls"]
    worker_s, flight_s = _costs(with_keys)
    beat_s = worker_s * LEASE_S / BEATS_PER_LEASE
    yield f"Core time of the books: {1e3 * flight_s:.1f} ms a flight and {1e3 * worker_s:.2f} ms a second for each"
    yield f"worker that is there (mTLS, least squares over {len(with_keys)} cells), which is {1e3 * beat_s:.2f} ms"
    yield f"a heartbeat, polls and all; of those the books want no more than {BEATS_PER_S_MAX:.0f} a second. Journal"
    yield f"{journal_kb:.1f} KB a flight, trace {TRACE_KB:.0f} KB a minute of flight."
    yield ""
    yield "| simulators | pace | flights a second | cores of the books | journal, GB a day | traces on the bus, MB/s |"
    yield "|---|---|---|---|---|---|"
    for pace, pace_s in PACES:
        for count in SIMULATORS:
            rate = count / pace_s
            journal = rate * journal_kb * 86_400 / 1e6
            beats = min(count * BEATS_PER_LEASE / LEASE_S, BEATS_PER_S_MAX)
            share, traces = rate * flight_s + beats * beat_s, rate * TRACE_KB / 1e3
            yield f"| {count:,} | {pace} | {rate:,.1f} | {share:,.2f} | {journal:,.1f} | {traces:,.1f} |"


def _costs(cells: list[Row]) -> tuple[float, float]:
    """Return the books' core time for a worker and second (heartbeats, polls) and for a flight, seconds."""
    causes = np.array([[row["workers"], row["flights"] / row["seconds"]] for row in cells])
    (worker, flight), *_ = np.linalg.lstsq(causes, np.array([row["books_core_share"] for row in cells]), rcond=None)
    return float(worker), float(flight)
