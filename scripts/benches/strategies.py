"""`scripts/bench strategies`: what each strategy finds in a whole campaign with the same budget, scorer and seeds.

    scripts/bench strategies [--campaigns avoidance-m2] [--arms NAME[/SCORER][:SETTING=VALUE,...] ...] [--scorer blend]
                             [--rng-seeds 1 2 3] [--budget 100] [--candidates N] [--against CHECKOUT] [--first-only]
                             [--jobs 1] [--rows FILE] [--json] [--told ROWS] [--module FILE]

Every arm flies the campaign as shipped, only the strategy (and what the arm sets) differs; `default` is the strategy as
shipped, `default/random` the same test cases chosen by chance. Real books, scorers, JSBSim
flights and oracle in one process. `--against` runs the arms of another checkout besides, called `against NAME`. Told
are behaviours (distinct) and confirmed violations, behaviours per minute of the processor time of that process, flights
to the first one, and simulated minutes a flight: medians over the seeds with the least and the most. How deep they go:
the least distance of any first flight and, of the confirmed behaviours, those with a find below 1 m and below 0.25 m,
those whose deepest find is below 0.25 m in two of three re-flights, too (held), and collisions. With `--first-only`
nothing is flown again but those deepest finds: first flights are the same in half the time, and behaviours are those
shown once. `--told` reports rows of earlier runs. `--module` gives a strategy or scorer of one's own.
"""

from __future__ import annotations

import argparse
import json
import os
import sqlite3
import subprocess
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
from saflite.campaign.storage.contents import Contents
from saflite.console.operations import judging
from saflite.contract import modules
from saflite.contract.config import Campaign, ScorerConfig, StrategyConfig
from saflite.contract.control import Status
from saflite.contract.test_case import Setting, TestCase
from saflite.contract.work import FlyWork
from saflite.mutator.registry import options_of, strategy_names
from saflite.simulator_worker.processes import die_with_parent

AGAINST, DEFAULT = "against ", "default"
DEEP_M, NEAR_M = 0.25, 1.0  # where the competition gives 5 points, and 2
HELD, REFLIGHTS = 2, 3
WALL_LIMIT_S = 600.0
FIRST_ONLY = {"confirm_flights": 0, "confirm_needed": 1, "check_share": 0.0}

ARMS = ("random_boxes:gates=0", "random_boxes", "random_boxes:gates=1", "deephyperion:population=16", "near_miss")


class Depth(NamedTuple):
    """How deep a campaign went: least distance of any first flight; the rest counts behaviours that stand."""

    least_m: float | None
    collisions: int
    below_025: int
    below_1: int
    held_025: int


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
    depth: Depth


class Counted(Flights):
    """Counts the simulated time of the flights flown."""

    def __init__(self) -> None:
        super().__init__()
        self.simulated_s = 0.0

    def _fly(self, work: FlyWork, cancelled: Any) -> Any:
        flight, packed = super()._fly(work, cancelled)
        self.simulated_s += flight.simulated_s
        return flight, packed


def settings_of(arm: str) -> tuple[str, str, dict[str, Setting]]:
    """Return strategy, scorer (empty: not said) and settings of an arm written as `name/scorer:setting=value,...`."""
    named, _, rest = arm.partition(":")
    name, _, scorer = named.partition("/")
    options, settings = options_of(name), {}
    for part in filter(None, rest.split(",")):
        word, _, text = part.partition("=")
        kind = type(options[word].default) if word in options else str
        settings[word] = kind(text)
    return name, scorer, settings


def campaign_of(name: str, arm: str, rng_seed: int, args: argparse.Namespace) -> Campaign:
    """Return the shipped campaign with the arm's strategy."""
    base = load_campaign(name)
    if arm.partition("/")[0] == DEFAULT:
        strategy, scorer, settings = base.strategy.name, arm.partition("/")[2], base.strategy.settings
    else:
        strategy, scorer, settings = settings_of(arm)
    search = base.search
    if args.candidates:
        search = msgspec.structs.replace(search, candidates_per_round=args.candidates)
    if args.first_only:
        search = msgspec.structs.replace(search, **FIRST_ONLY)
    named = scorer or args.scorer or base.scorer.model
    return msgspec.structs.replace(
        base,
        strategy=StrategyConfig(name=strategy, settings=settings),
        scorer=ScorerConfig(model=named, batch=base.scorer.batch),
        search=search,
        budget_flights=args.budget,
        rng_seed=rng_seed,
        record="none",
    )


def run(job: tuple[str, str, int, argparse.Namespace]) -> Result:
    """Run one campaign to its end."""
    name, arm, rng_seed, args = job
    if arm.startswith(AGAINST):
        return elsewhere(name, arm, rng_seed, args)
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
        core_s = time.process_time() - core_start_s
        distinct, depth = weighed(run_dir, "" if args.first_only else "confirmed")
    return Result(
        campaign=name,
        arm=arm,
        rng_seed=rng_seed,
        flights=status.flights,
        confirmed=status.violations_confirmed,
        distinct=distinct,
        first=first,
        simulated_min=flights.simulated_s / 60.0 / max(1, flights.flown),
        core_s=round(core_s, 1),
        wall_s=round(time.perf_counter() - start, 1),
        depth=depth,
    )


def elsewhere(name: str, arm: str, rng_seed: int, args: argparse.Namespace) -> Result:
    """Run one campaign of the checkout to compare with, in a process of its own."""
    words = ["--campaigns", name, "--arms", arm.removeprefix(AGAINST), "--rng-seeds", str(rng_seed), "--json"]
    words += ["--budget", str(args.budget), "--candidates", str(args.candidates), "--scorer", args.scorer]
    words += ["--first-only"] if args.first_only else []
    words += [word for file in args.module for word in ("--module", str(file.absolute()))]
    command = [sys.executable, str(Path(__file__).parents[1] / "bench"), "strategies", *words]
    environment = {**os.environ, "PYTHONPATH": str(Path(args.against) / "services")}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    return _result(json.loads(done.stdout)[0])._replace(arm=arm)


def _result(row: dict[str, Any]) -> Result:
    return Result(**{**row, "depth": Depth(**row["depth"])})


def _row(result: Result) -> dict[str, Any]:
    return {**result._asdict(), "depth": result.depth._asdict()}


def weighed(run_dir: Path, confirmation: str) -> tuple[int, Depth]:
    """Return how many behaviours stand in a run folder and how deep it went; flies again the deepest below 0.25 m."""
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
        contents = Contents(database)
        stand = {one.fingerprint: one for one in contents.violations(confirmation, similar=False)}
        flown_m: list[float] = []
        deepest: dict[str, tuple[float, TestCase]] = {}
        for outcome in contents.outcomes(-1, 10**9):
            distance_m = outcome.features.get("min_distance_m")
            if distance_m is None:
                continue
            flown_m.append(distance_m)
            for name in stand.keys() & set(outcome.behaviours):
                if name not in deepest or distance_m < deepest[name][0]:
                    deepest[name] = distance_m, outcome.test_case
    deep = [case for distance_m, case in deepest.values() if distance_m < DEEP_M]
    return len(stand), Depth(
        least_m=min(flown_m, default=None),
        collisions=sum(one.severity == "hard" for one in stand.values()),
        below_025=len(deep),
        below_1=sum(distance_m < NEAR_M for distance_m, _ in deepest.values()),
        held_025=held(deep),
    )


def held(cases: list[TestCase]) -> int:
    """Return how many test cases come below 0.25 m in two of three flights under other noise."""
    simulator = judging.OwnSimulator()
    try:
        return sum(_holds(case, simulator) for case in cases)
    finally:
        simulator.close()


def _holds(case: TestCase, simulator: judging.OwnSimulator) -> bool:
    again = 0
    for noise in range(1, 1 + REFLIGHTS):
        flown = simulator.fly(case, WALL_LIMIT_S, noise, noise)
        features = judging.judge(case, flown, ("min-obstacle-distance",), None).features
        again += features.get("min_distance_m", DEEP_M) < DEEP_M
    return again >= HELD


def _spread(numbers: list[int]) -> str:
    return f"{median(numbers):5.1f} [{min(numbers)}-{max(numbers)}]"


def least(depths: list[Depth]) -> str:
    """Return the least distances in words, seed by seed."""
    return " ".join("-" if one.least_m is None else f"{one.least_m:.2f}" for one in depths)


def report(results: list[Result]) -> None:
    """Print one line per campaign and arm."""
    out = sys.stdout
    out.write(
        f"{'campaign':14s} {'arm':34s} {'distinct':>14s} {'per core-minute':>18s} {'confirmed':>14s} {'first':>12s}"
        "  min/flight  below 1 m       0.25 m    held collisions  least m\n"
    )
    for key in dict.fromkeys((result.campaign, result.arm) for result in results):
        mine = [result for result in results if (result.campaign, result.arm) == key]
        deep = [result.depth for result in mine]
        rates = [60.0 * result.distinct / result.core_s for result in mine]
        firsts = [result.first for result in mine if result.first]
        first = f"{median(firsts):5.1f} of {len(firsts)}/{len(mine)}" if firsts else "none"
        out.write(
            f"{key[0]:14s} {key[1]:34s} {_spread([one.distinct for one in mine]):>14s} "
            f"{median(rates):6.2f} [{min(rates):.2f}-{max(rates):.2f}] "
            f"{_spread([one.confirmed for one in mine]):>14s} {first:>12s}  "
            f"{median(one.simulated_min for one in mine):10.1f} {_spread([one.below_1 for one in deep]):>12s} "
            f"{_spread([one.below_025 for one in deep]):>12s} {sum(one.held_025 for one in deep):7d} "
            f"{sum(one.collisions for one in deep):10d}  {least(deep)}\n"
        )


def _begin(parent: int, files: list[Path]) -> None:
    """Begin a process of the pool: it ends with its parent, and knows the modules that the parent was given."""
    die_with_parent(parent)
    modules.use(files)


def main(argv: list[str]) -> int:
    """Run every arm with every seed."""
    parser = argparse.ArgumentParser(prog="scripts/bench strategies", description=__doc__.splitlines()[0])
    parser.add_argument("--campaigns", nargs="+", default=["avoidance-m2"])
    parser.add_argument("--arms", nargs="+", default=list(ARMS), help=f"strategies: {', '.join(strategy_names())}")
    parser.add_argument("--scorer", default="", help="the campaign's own if left out")
    parser.add_argument("--rng-seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--candidates", type=int, default=0)
    parser.add_argument("--against", default="", metavar="CHECKOUT")
    parser.add_argument("--first-only", action="store_true", help="no re-flights; behaviours are those shown once")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--rows", type=Path, help="file the raw rows are added to, one JSON object a line")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--told", type=Path, metavar="ROWS", help="report these rows and run nothing")
    parser.add_argument(
        "--module", type=Path, action="append", default=[], metavar="FILE", help="strategy of one's own"
    )
    args = parser.parse_args(argv)
    modules.use(args.module)
    if args.told:
        report([_result(json.loads(line)) for line in args.told.read_text(encoding="utf-8").splitlines()])
        return 0
    arms = [*args.arms, *(AGAINST + arm for arm in args.arms if args.against and not arm.startswith(AGAINST))]
    jobs = [(name, arm, seed, args) for name in args.campaigns for seed in args.rng_seeds for arm in arms]
    with get_context("spawn").Pool(args.jobs, _begin, (os.getpid(), args.module)) as pool:
        results = []
        for result in pool.imap(run, jobs):
            results.append(result)
            sys.stderr.write(f"{result}\n")
            if args.rows:
                with args.rows.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(_row(result)) + "\n")
    if args.json:
        sys.stdout.write(json.dumps([_row(result) for result in results], indent=2) + "\n")
    else:
        report(results)
    return 0
