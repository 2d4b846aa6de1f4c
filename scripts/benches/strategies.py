"""`scripts/bench strategies`: what each strategy finds in a whole campaign with the same budget, scorer and seeds.

    scripts/bench strategies [--campaigns avoidance-m2] [--arms NAME[:SETTING=VALUE,...] ...] [--scorer blend]
                             [--rng-seeds 1 2 3] [--budget 100] [--candidates N] [--jobs 1] [--rows FILE] [--json]

Every arm flies the campaign as shipped, only the strategy (and what the arm sets) differs: real books, scorers, JSBSim
flights and oracle in one process. Told are behaviours (distinct) and
confirmed violations, behaviours per minute of the processor time of that process, flights to the first one, and
simulated minutes a flight: medians over the seeds with the least and the most.
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import sys
import tempfile
import time
from contextlib import closing
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import msgspec
from _inline import Flights, Inline

from saflite.campaign.presets.campaigns import load_campaign
from saflite.contract.config import Campaign, ScorerConfig, StrategyConfig
from saflite.contract.control import Status
from saflite.contract.test_case import Setting
from saflite.contract.work import FlyWork
from saflite.mutator.registry import options_of, strategy_names
from saflite.simulator_worker.processes import die_with_parent

ARMS = ("random_boxes:gates=0", "random_boxes", "random_boxes:gates=1", "deephyperion:population=16", "near_miss")


class Result(NamedTuple):
    """One campaign. `first` is the flights spent when the first violation was confirmed, 0 where there was none."""

    campaign: str
    arm: str
    rng_seed: int
    flights: int
    confirmed: int
    distinct: int
    first: int
    simulated_min: float
    core_s: float
    wall_s: float


class Counted(Flights):
    """Counts the simulated time of the flights flown."""

    def __init__(self) -> None:
        super().__init__()
        self.simulated_s = 0.0

    def _fly(self, work: FlyWork, cancelled: Any) -> Any:
        flight, packed = super()._fly(work, cancelled)
        self.simulated_s += flight.simulated_s
        return flight, packed


def settings_of(arm: str) -> tuple[str, dict[str, Setting]]:
    """Return strategy and settings of an arm written as `name:setting=value,...`."""
    name, _, rest = arm.partition(":")
    options, settings = options_of(name), {}
    for part in filter(None, rest.split(",")):
        word, _, text = part.partition("=")
        kind = type(options[word].default) if word in options else str
        settings[word] = kind(text)
    return name, settings


def campaign_of(name: str, arm: str, rng_seed: int, args: argparse.Namespace) -> Campaign:
    """Return the shipped campaign with the arm's strategy."""
    base = load_campaign(name)
    strategy, settings = settings_of(arm)
    search = base.search
    if args.candidates:
        search = msgspec.structs.replace(search, candidates_per_round=args.candidates)
    scorer = ScorerConfig(model=args.scorer, batch=base.scorer.batch) if args.scorer else base.scorer
    return msgspec.structs.replace(
        base,
        strategy=StrategyConfig(name=strategy, settings=settings),
        scorer=scorer,
        search=search,
        budget_flights=args.budget,
        rng_seed=rng_seed,
        record="none",
    )


def run(job: tuple[str, str, int, argparse.Namespace]) -> Result:
    """Run one campaign to its end."""
    name, arm, rng_seed, args = job
    flights, start, core_start_s, first = Counted(), time.perf_counter(), time.process_time(), 0

    def look(status: Status) -> bool:
        nonlocal first
        if not first and status.violations_confirmed:
            first = status.flights
        return False

    with tempfile.TemporaryDirectory(prefix="saflite-strategies-") as folder:
        run_dir = Path(folder) / "run"
        inline = Inline(campaign_of(name, arm, rng_seed, args), run_dir, flights)
        status = inline.run(look)
        inline.close()
        distinct = fingerprints(run_dir)
    return Result(
        campaign=name,
        arm=arm,
        rng_seed=rng_seed,
        flights=status.flights,
        confirmed=status.violations_confirmed,
        distinct=distinct,
        first=first,
        simulated_min=flights.simulated_s / 60.0 / max(1, flights.flown),
        core_s=round(time.process_time() - core_start_s, 1),
        wall_s=round(time.perf_counter() - start, 1),
    )


def fingerprints(run_dir: Path) -> int:
    """Return how many different violations were confirmed."""
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
        query = "SELECT COUNT(DISTINCT fingerprint) FROM violations WHERE confirmation = 'confirmed'"
        return int(database.execute(query).fetchone()[0])


def _spread(numbers: list[int]) -> str:
    return f"{median(numbers):5.1f} [{min(numbers)}-{max(numbers)}]"


def report(results: list[Result]) -> None:
    """Print one line per campaign and arm."""
    out = sys.stdout
    out.write(
        f"{'campaign':14s} {'arm':34s} {'distinct':>14s} {'per core-minute':>18s} {'confirmed':>14s} {'first':>12s}"
        "  min/flight\n"
    )
    for key in dict.fromkeys((result.campaign, result.arm) for result in results):
        mine = [result for result in results if (result.campaign, result.arm) == key]
        rates = [60.0 * result.distinct / result.core_s for result in mine]
        firsts = [result.first for result in mine if result.first]
        first = f"{median(firsts):5.1f} of {len(firsts)}/{len(mine)}" if firsts else "none"
        out.write(
            f"{key[0]:14s} {key[1]:34s} {_spread([one.distinct for one in mine]):>14s} "
            f"{median(rates):6.2f} [{min(rates):.2f}-{max(rates):.2f}] "
            f"{_spread([one.confirmed for one in mine]):>14s} {first:>12s}  "
            f"{median(one.simulated_min for one in mine):.1f}\n"
        )


def main(argv: list[str]) -> int:
    """Run every arm with every seed."""
    parser = argparse.ArgumentParser(prog="scripts/bench strategies", description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", nargs="+", default=["avoidance-m2"])
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help=f"strategies: {', '.join(strategy_names())}")
    parser.add_argument("--scorer", default="", help="the campaign's own if left out")
    parser.add_argument("--rng-seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--candidates", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="file the raw rows are added to, one JSON object a line")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    jobs = [(name, arm, seed, args) for name in args.campaigns for seed in args.rng_seeds for arm in args.arms]
    with get_context("spawn").Pool(args.jobs, die_with_parent, (os.getpid(),)) as pool:
        results = []
        for result in pool.imap(run, jobs):
            results.append(result)
            sys.stderr.write(f"{result}\n")
            if args.rows:
                with args.rows.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(result._asdict()) + "\n")
    if args.json:
        sys.stdout.write(json.dumps([result._asdict() for result in results], indent=2) + "\n")
    else:
        report(results)
    return 0
