"""Speed of flights in this checkout against another one's, flown in turns.

Each turn asks both checkouts for their own figures (`scripts/bench flight --json`) in a process of its own, with the
interpreter of that checkout; who begins changes from turn to turn, so that a machine that grows busy slows both alike.
What counts is the ratio within a turn.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parents[2]
BARE = "bare"  # JSBSim alone: how alike two runs of the same code are


class Compared(NamedTuple):
    """One kind of flight: times real time in each checkout, and the ratio of each turn (above 1: we are faster)."""

    ours: float
    theirs: float
    ratios: tuple[float, ...]


def figures(checkout: Path, rounds: int) -> dict[str, float]:
    """Return times real time by kind of flight, as a checkout measures itself."""
    own = checkout / ".venv" / "bin" / "python"
    command = [str(own if own.exists() else sys.executable), str(checkout / "scripts" / "bench"), "flight"]
    command += ["--rounds", str(rounds), "--json"]
    output = subprocess.run(command, capture_output=True, text=True, check=True, cwd=checkout).stdout
    kinds = json.loads(output)["kinds"]
    return {name: float(row["real_time_factor"]) for name, row in kinds.items()}


def compare(other: Path, turns: int, rounds: int) -> dict[str, Compared]:
    """Measure both checkouts in turns."""
    pairs: list[tuple[dict[str, float], dict[str, float]]] = []
    for turn in range(turns):
        order = (HERE, other) if turn % 2 == 0 else (other, HERE)
        found = {checkout: figures(checkout, rounds) for checkout in order}
        pairs.append((found[HERE], found[other]))
    return {
        name: Compared(
            statistics.median(ours[name] for ours, _ in pairs),
            statistics.median(theirs[name] for _, theirs in pairs),
            tuple(ours[name] / theirs[name] for ours, theirs in pairs),
        )
        for name in pairs[0][0]
        if name in pairs[0][1]
    }


def show(compared: dict[str, Compared]) -> None:
    """Print one line per kind of flight."""
    print(f"{'':20} {'here':>9} {'there':>9}   ratio: {'least':>7} {'median':>7} {'most':>7}   (x real time; turns)")
    for name, row in compared.items():
        ratios = f"{min(row.ratios):7.3f} {statistics.median(row.ratios):7.3f} {max(row.ratios):7.3f}"
        print(f"{name:20} {row.ours:9.1f} {row.theirs:9.1f}          {ratios}   ({len(row.ratios)})")


def slower(compared: dict[str, Compared], least: float) -> list[str]:
    """Return the kinds whose median ratio is below `least`, leaving out JSBSim alone."""
    medians = {name: statistics.median(row.ratios) for name, row in compared.items() if not name.startswith(BARE)}
    return [f"{name}: {ratio:.3f}" for name, ratio in medians.items() if ratio < least]
