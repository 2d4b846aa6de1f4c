"""Whole campaigns on one machine: flights a second with 1 and 2 simulator workers, and how long workers wait.

A worker waits while it holds no flight: the share is taken between the first lease and the last flight's end, once
over the whole campaign and once without its last fifth, where a budget that runs out leaves too little to do.
"""

from __future__ import annotations

import argparse
import json
import sqlite3
import sys
import tempfile
from pathlib import Path
from typing import Any

import msgspec

from saflite.bus.zenoh import leave_process
from saflite.campaign.presets.campaigns import load_campaign
from saflite.contract.control import Status
from saflite.runtime.campaign_runner import run_campaign
from saflite.runtime.clock import WallClock


def measure(name: str, budget: int, simulators: int, rng_seed: int) -> dict[str, Any]:
    """Run one campaign and return its figures."""
    campaign = msgspec.structs.replace(load_campaign(name), budget_flights=budget, rng_seed=rng_seed)
    memory: dict[str, float] = {}

    def note(status: Status) -> None:
        for worker in status.workers:
            memory[worker.stage] = max(memory.get(worker.stage, 0.0), worker.resident_mib)

    clock = WallClock()
    with tempfile.TemporaryDirectory(prefix="saflite-bench-") as folder:
        run_dir = Path(folder) / "run"
        began_s = clock.monotonic_s()
        began_unix_s = clock.unix_s()
        summary = run_campaign(campaign, run_dir, simulators=simulators, on_status=note)
        took_s = clock.monotonic_s() - began_s
        assert summary.status is not None
        assert summary.ended
        return {
            "simulators": simulators,
            "flights": summary.status.flights,
            "violations_confirmed": summary.status.violations_confirmed,
            "wall_s": round(took_s, 1),
            "flights_per_s": round(summary.status.flights / took_s, 3),
            **_from_store(run_dir, simulators, began_unix_s),
            "most_resident_mib": memory,
            "restarts": summary.restarts,
        }


def _from_store(run_dir: Path, simulators: int, began_unix_s: float) -> dict[str, Any]:
    connection = sqlite3.connect(run_dir / "books.sqlite")
    leases = connection.execute(
        "SELECT worker, from_unix_s, to_unix_s FROM attempts WHERE stage = 'fly' ORDER BY to_unix_s"
    ).fetchall()
    simulated_s, wall_s = connection.execute("SELECT sum(simulated_s), sum(wall_s) FROM flights").fetchone()
    found = connection.execute("SELECT min(at_unix_s) FROM events WHERE kind = 'violation'").fetchone()[0]
    connection.close()
    most = leases[: len(leases) * 4 // 5]
    return {
        "flight_wall_s": round(wall_s / len(leases), 3),
        "real_time_factor_of_a_worker": round(simulated_s / wall_s, 1),
        "first_violation_after_s": None if found is None else round(found - began_unix_s, 1),
        "waiting_share": _waiting(leases, simulators),
        "waiting_share_first_four_fifths": _waiting(most, simulators),
    }


def _waiting(leases: list[tuple[str, float, float]], simulators: int) -> float:
    """Return the share of the workers' time in which they held no lease."""
    first_s, last_s = min(lease[1] for lease in leases), max(lease[2] for lease in leases)
    held_s = 0.0
    for worker in {lease[0] for lease in leases}:
        until_s = 0.0
        for _, from_s, to_s in sorted(lease for lease in leases if lease[0] == worker):
            held_s += max(0.0, to_s - max(from_s, until_s))
            until_s = max(until_s, to_s)
    return round(1 - held_s / (simulators * (last_s - first_s)), 3)


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench farm", description=__doc__.partition("\n")[0])
    parser.add_argument("--campaign", default="avoidance-m2")
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--rng-seed", type=int, default=1)
    parser.add_argument("--simulators", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    runs = [measure(options.campaign, options.budget, count, options.rng_seed) for count in options.simulators]
    ratio = round(runs[-1]["flights_per_s"] / runs[0]["flights_per_s"], 2)
    if options.json:
        print(json.dumps({"runs": runs, "speed_up": ratio}))
    else:
        for run in runs:
            for key, value in run.items():
                print(f"{key:34} {value}")
            print()
        print(f"{'speed-up':34} {ratio}")
    sys.stdout.flush()
    leave_process(0)
