"""`scripts/bench behaviours`: new behaviours per core-minute of whole farms, all processes counted, arm by arm.

    scripts/bench behaviours [--campaigns avoidance-m3 avoidance-m5] [--arms default random] [--rng-seeds 1 2 3]
                             [--budget 100] [--against CHECKOUT] [--rows FILE]

An arm is `default` (the campaign as shipped), `random` (the same candidates, picked by chance), or any strategy, with a
scorer if need be, as `name[/scorer][:setting=value,...]`; `--against` runs the shipped campaign of another checkout
besides. Every arm is a farm of its own, run by `saflite run`; its processor time is that of all its processes. What it
confirmed is counted by one yardstick: the test cases are flown and judged here, in order, told apart as the books do,
and one of each behaviour must violate in 2 of 3 flights under other noise. Told besides are the least distance and the
points of the competition of what stood.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from saflite.console.io.cases import load_case
from saflite.console.operations import judging
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Verdict
from saflite.flight.track_shape import SAME_SHAPE_M, Shape, gap_m, shape_of

POLICY = "min-obstacle-distance"
NEEDED, FLIGHTS = 2, 3
WALL_LIMIT_S = 600.0
OLD = "against"


class Row(NamedTuple):
    """One farm: what it flew and confirmed, what that was by the yardstick, and what it cost."""

    campaign: str
    arm: str
    rng_seed: int
    flights: int
    finds: int
    behaviours: int
    hard: int
    least_distance_m: float | None
    points: float
    core_min: float


class Way(NamedTuple):
    """A behaviour by the yardstick."""

    words: str
    shape: Shape


def run_farm(
    campaign: str, arm: str, rng_seed: int, args: argparse.Namespace, folder: Path
) -> tuple[dict[str, Any], float]:
    """Run a farm to its end; returns its summary and the processor minutes of all its processes."""
    words = [sys.executable, "-m", "saflite", "run", campaign, "--out", str(folder / "run"), "--json"]
    words += ["--budget", str(args.budget), "--rng-seed", str(rng_seed)]
    if arm == "random":
        words += ["--scorer", "random"]
    elif arm not in ("default", OLD):
        named, _, settings = arm.partition(":")
        name, _, scorer = named.partition("/")
        words += ["--strategy", name, *(("--scorer", scorer) if scorer else ())]
        words += [part for one in filter(None, settings.split(",")) for part in ("--set", one)]
    where = Path(args.against) if arm == OLD else Path(__file__).parents[2]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        words, cwd=where, env={**os.environ, "PYTHONPATH": str(where / "services")}, capture_output=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert done.returncode in (0, 1), done.stderr.decode()[-2000:]
    spent_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return json.loads(done.stdout), spent_s / 60.0


def yardstick(cases: list[TestCase]) -> tuple[int, int, float | None, float]:
    """Return behaviours that stand, hard ones among them, the least distance and the points of what stood."""
    known: list[Way] = []
    hard, distances, points = 0, list[float](), 0.0
    simulator = judging.OwnSimulator()
    try:
        for case in cases:
            verdict, distance_m, shape = _judged(simulator, case, 0)
            if verdict is None or any(
                one.words == verdict.behaviour and gap_m(one.shape, shape) <= SAME_SHAPE_M for one in known
            ):
                continue
            again = sum(_judged(simulator, case, noise)[0] is not None for noise in range(1, FLIGHTS + 1))
            if again >= NEEDED:
                known.append(Way(verdict.behaviour, shape))
                hard += verdict.severity == "hard"
                distances.append(distance_m)
                points += verdict.points
    finally:
        simulator.close()
    return len(known), hard, min(distances, default=None), points


def _judged(simulator: judging.OwnSimulator, case: TestCase, noise: int) -> tuple[Verdict | None, float, Shape]:
    flown = simulator.fly(case, WALL_LIMIT_S, noise, noise)
    judgement = judging.judge(case, flown, (POLICY,), None)
    bad = next((one for one in judgement.verdicts if one.outcome == "violated" and one.policy == POLICY), None)
    return bad, judgement.features.get("min_distance_m", float("nan")), shape_of(judgement.track)


def measure(campaign: str, arm: str, rng_seed: int, args: argparse.Namespace) -> Row:
    """Run one farm and weigh what it confirmed."""
    with tempfile.TemporaryDirectory(prefix="saflite-behaviours-") as name:
        summary, core_min = run_farm(campaign, arm, rng_seed, args, Path(name))
        firm = [one["test_case"] for one in summary["violations"] if one["confirmation"] == "confirmed"]
        files = {Path(file).stem: Path(file) for file in summary["test_cases"] if file.endswith(".yaml")}
        cases = [load_case(files[stem]) for stem in dict.fromkeys(firm)]
        behaviours, hard, least_m, points = yardstick(cases)
    finds = len(firm) + sum(1 for one in summary["violations"] if one["confirmation"] == "similar")
    return Row(
        campaign, arm, rng_seed, summary["flights"], finds, behaviours, hard, least_m, points, round(core_min, 3)
    )


def report(rows: list[Row]) -> None:
    """Print one line per campaign and arm: medians over the seeds, with the least and the most."""
    out = sys.stdout
    out.write(
        f"{'campaign':14s} {'arm':24s} {'per core-minute':>22s} {'behaviours':>14s} {'hard':>5s} {'least m':>8s}\n"
    )
    for key in dict.fromkeys((row.campaign, row.arm) for row in rows):
        mine = [row for row in rows if (row.campaign, row.arm) == key]
        rates = [row.behaviours / row.core_min for row in mine]
        counts = [row.behaviours for row in mine]
        distances = [row.least_distance_m for row in mine if row.least_distance_m is not None]
        least = f"{min(distances):.2f}" if distances else "-"
        out.write(
            f"{key[0]:14s} {key[1]:24s} {median(rates):8.2f} [{min(rates):.2f}-{max(rates):.2f}]"
            f" {median(counts):6.1f} [{min(counts)}-{max(counts)}] {sum(row.hard for row in mine):5d} {least:>8s}\n"
        )


def main(argv: list[str]) -> int:
    """Run every arm with every seed, in turns."""
    parser = argparse.ArgumentParser(prog="scripts/bench behaviours", description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", nargs="+", default=["avoidance-m3", "avoidance-m5"])
    parser.add_argument("--arms", nargs="+", default=["default", "random"])
    parser.add_argument("--rng-seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--against", default="", metavar="CHECKOUT")
    parser.add_argument("--rows", type=Path, help="file the raw rows are added to, one JSON object a line")
    args = parser.parse_args(argv)
    rows: list[Row] = []
    for campaign in args.campaigns:
        for rng_seed in args.rng_seeds:
            for arm in (*args.arms, *((OLD,) if args.against else ())):
                rows.append(measure(campaign, arm, rng_seed, args))
                text = json.dumps(rows[-1]._asdict())
                sys.stderr.write(text + "\n")
                if args.rows:
                    with args.rows.open("a", encoding="utf-8") as file:
                        file.write(text + "\n")
    report(rows)
    return 0
