"""Speed of flights in this checkout against another one's, flown in turns.

A process per checkout, with the interpreter and the package of that checkout, flies one flight at a time; who begins
changes from turn to turn. So a machine that grows busy slows both alike, and what counts is the ratio within a turn.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).resolve().parents[2]
CHILD = Path(__file__).resolve().parent / "_flight_child.py"
BARE = "bare"  # JSBSim alone: how alike two runs of the same code are
KINDS = (BARE, "avoidance", "policy", "kinematic")
LAYOUTS = 100


class Compared(NamedTuple):
    """One kind of flight: times real time in each checkout, and the ratio of each turn (above 1: we are faster)."""

    ours: float
    theirs: float
    ratios: tuple[float, ...]


def interpreter(checkout: Path) -> str:
    """Return the Python a checkout runs with: its own environment's, or this one's."""
    own = checkout / ".venv" / "bin" / "python"
    return str(own if own.exists() else sys.executable)


def environment(checkout: Path) -> dict[str, str]:
    """Return the environment in which a checkout's own package is imported."""
    return {**os.environ, "PYTHONPATH": str(checkout / "services")}


def build(checkout: Path) -> None:
    """Compile a checkout's native library where that was not done."""
    if not next((checkout / "services").rglob("native/_native.so"), None):
        command = [interpreter(checkout), "scripts/build_native.py"]
        subprocess.run(command, check=True, cwd=checkout, env=environment(checkout), stdout=subprocess.DEVNULL)


class Flyer:
    """A checkout's process; exits with its words where it fails."""

    def __init__(self, checkout: Path) -> None:
        build(checkout)
        self._checkout, self._words = checkout, tempfile.TemporaryFile("w+")  # noqa: SIM115 (a pipe nobody reads would fill up)
        self._process = subprocess.Popen(
            [interpreter(checkout), str(CHILD), str(checkout / "scripts" / "benches")],
            cwd=checkout,
            env=environment(checkout),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            text=True,
        )

    def speed(self, kind: str, index: int) -> float:
        """Fly once; return simulated seconds per second of processor time."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(f"{kind} {index}\n")
            self._process.stdin.flush()
        answer = self._process.stdout.readline().split()
        if not answer:
            self._process.wait()
            self._words.seek(0)
            raise SystemExit(f"{self._checkout}: {kind} failed:\n{self._words.read()[-2000:]}")
        return float(answer[0]) / float(answer[1])

    def close(self) -> None:
        """End the process."""
        self._process.communicate()
        self._words.close()


def compare(here: Path, other: Path, turns: int) -> dict[str, Compared]:
    """Fly each kind `turns` times in both checkouts, in turns, after one flight of each that does not count."""
    flyers = (Flyer(here), Flyer(other))
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    for turn in range(turns + 1):
        for kind in KINDS:
            order = flyers if turn % 2 == 0 else flyers[::-1]
            speeds = {flyer: flyer.speed(kind, turn % LAYOUTS) for flyer in order}
            found[kind].append((speeds[flyers[0]], speeds[flyers[1]]))
    for flyer in flyers:
        flyer.close()
    return {kind: _compared(pairs[1:]) for kind, pairs in found.items()}


def _compared(pairs: list[tuple[float, float]]) -> Compared:
    ours, theirs = zip(*pairs, strict=True)
    ratios = tuple(here / there for here, there in pairs)
    return Compared(statistics.median(ours), statistics.median(theirs), ratios)


def show(compared: dict[str, Compared]) -> None:
    """Print one line per kind of flight."""
    print(f"{'x real time':12} {'here':>9} {'there':>9}    ratio: {'least':>7} {'median':>7} {'most':>7}")
    for name, row in compared.items():
        ratios = f"{min(row.ratios):7.3f} {statistics.median(row.ratios):7.3f} {max(row.ratios):7.3f}"
        print(f"{name:12} {row.ours:9.1f} {row.theirs:9.1f}           {ratios}   in {len(row.ratios)} turns")


def slower(compared: dict[str, Compared], least: float) -> list[str]:
    """Return the kinds whose median ratio is below `least`, leaving out JSBSim alone."""
    medians = {name: statistics.median(row.ratios) for name, row in compared.items() if name != BARE}
    return [f"{name}: {ratio:.3f}" for name, ratio in medians.items() if ratio < least]
