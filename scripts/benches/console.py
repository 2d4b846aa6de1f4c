"""How long a command line takes to answer: `saflite --help`, and the help of every command, in fresh processes.

    scripts/bench console [--rounds 5] [--json]

Shown are the medians of wall and processor time; the aim is 100 ms for `saflite --help`.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from typing import NamedTuple

from saflite.console.cli import command_names

AIM_MS = 100.0


class Row(NamedTuple):
    """One command: medians."""

    command: str
    wall_ms: float
    cpu_ms: float


def measured(words: tuple[str, ...], rounds: int) -> Row:
    """Time a command in fresh processes, after one that is not counted."""
    program = [sys.executable, "-m", "saflite", *words]
    walls, cpus = [], []
    for _ in range(rounds + 1):
        before, began_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(program, stdout=subprocess.DEVNULL, check=True)
        walls.append(1e3 * (time.perf_counter() - began_s))
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpus.append(1e3 * (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime))
    return Row(" ".join(("saflite", *words)), statistics.median(walls[1:]), statistics.median(cpus[1:]))


def main(argv: list[str]) -> int:
    """Measure and print; 1 where `saflite --help` takes more processor time than its aim."""
    parser = argparse.ArgumentParser(prog="scripts/bench console", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    commands = [("--help",), *((name, "--help") for name in command_names())]
    rows = [measured(words, options.rounds) for words in commands]
    for row in rows:
        print(
            json.dumps(row._asdict()) if options.json else f"{row.wall_ms:7.0f} ms {row.cpu_ms:7.0f} ms  {row.command}"
        )
    return int(rows[0].cpu_ms > AIM_MS)
