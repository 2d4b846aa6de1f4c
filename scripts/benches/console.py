"""How soon the console answers: the help of every command, and the dashboard's first paint over a run of many flights.

    scripts/bench console [--parts help dashboard] [--rounds 5] [--flights 10000] [--run RUN] [--json]

Part `help`: medians of wall and processor time in fresh processes; the aim is 100 ms of processor time for each.
Part `dashboard`: a run of so many flights is made by the books alone (minutes; `--run` takes one that is there), then
its page is loaded in headless Chromium; the aim is a first paint within 1 s.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from _dashboard_paint import made, paint

from saflite.console.cli import command_names

HELP_AIM_MS, PAINT_AIM_MS = 100.0, 1000.0


def measured(words: tuple[str, ...], rounds: int) -> tuple[float, float]:
    """Time a command in fresh processes, after one that is not counted; medians of wall and processor time in ms."""
    program = [sys.executable, "-m", "saflite", *words]
    walls, cpus = [], []
    for _ in range(rounds + 1):
        before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(program, stdout=subprocess.DEVNULL, check=True)
        walls.append(1e3 * (time.perf_counter() - began_s))
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpus.append(1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
    return statistics.median(walls[1:]), statistics.median(cpus[1:])


def help_of_all(options: argparse.Namespace) -> dict[str, Any]:
    """Measure `saflite --help` and the help of every command."""
    took = {
        " ".join(words): measured(words, options.rounds)
        for words in [("--help",), *((name, "--help") for name in command_names())]
    }
    slowest = max(took, key=lambda words: took[words][1])
    return {
        "commands": len(took),
        "help_wall_ms": round(took["--help"][0], 1),
        "help_cpu_ms": round(took["--help"][1], 1),
        "median_cpu_ms": round(statistics.median(cpu for _, cpu in took.values()), 1),
        "slowest": slowest,
        "slowest_wall_ms": round(took[slowest][0], 1),
        "slowest_cpu_ms": round(took[slowest][1], 1),
        "above_aim": sorted(words for words, (_, cpu) in took.items() if cpu > HELP_AIM_MS),
    }


def dashboard(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the dashboard's page over a run of many flights."""
    with tempfile.TemporaryDirectory() as folder:
        run = options.run or made(Path(folder) / "run", options.flights)
        return {"flights": options.flights, **paint(run, options.rounds)}


PARTS = {"help": help_of_all, "dashboard": dashboard}


def main(argv: list[str]) -> int:
    """Measure and print; 1 where an aim is missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench console", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=sorted(PARTS), default=list(PARTS))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--flights", type=int, default=10_000, help="of the run made, or of the one named")
    parser.add_argument("--run", type=Path, help="a run that is there, in place of making one")
    parser.add_argument("--json", action="store_true", help="one JSON object a part")
    options = parser.parse_args(argv)
    missed = False
    for name in options.parts:
        load = f"{os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"
        row = {"bench": "console", "part": name, "load": load, **PARTS[name](options)}
        missed |= bool(row.get("above_aim")) or float(row.get("first_paint_ms", 0.0)) > PAINT_AIM_MS
        if options.json:
            print(json.dumps(row), flush=True)
        else:
            print("\n".join(f"{key:24} {value}" for key, value in row.items()), flush=True)
    return int(missed)
