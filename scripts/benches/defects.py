"""`scripts/bench defects`: how soon is each planted defect found and minimised, and are there false alarms?

    scripts/bench defects [--part search alarms shrink] [--defects NAME ...] [--arms NAME ...] [--seeds 20] [--hours 24]
                          [--cases 2000] [--jobs 1] [--out FILE.jsonl] [--plot FILE.png] [--json]

search: for each defect, arm and seed the campaign of the defect's policy runs to its first confirmed violation, or
until `--hours` of simulated time are spent (a flight counts as its full minute). Told are rounds, flights, simulated
and wall time, and survival curves (the share not yet found after so many flights), censored searches counted as such;
beside them figures with every defect counted once, as easy ones are searched with more seeds.
Searches that stand in the `--out` file already are not run again, so a long table can be made in pieces.
alarms: mutants of all policy campaigns flown with all defects off and judged by all policies; every violation is a
false alarm.
shrink: the shortest known trigger of each defect, hidden among random inputs (twenty in all), is minimised on one core.

The full table (20 seeds, 24 h) takes days on one core: `--seeds`, `--hours`, `--arms` cut it.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from statistics import mean, median
from typing import Any

from _defect_search import ARMS, Found, search
from _defect_shrink import INPUTS, shrinks

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.presets.policy_campaigns import policy_campaigns
from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.rng import derive
from saflite.contract.test_case import TestCase, identity, told_in_order
from saflite.flight.autopilots.reference.defects import TABLE
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.registry import load_strategy
from saflite.oracle.judge import judge
from saflite.oracle.policy import policy_names
from saflite.simulator_worker.processes import die_with_parent

PARTS = ("search", "alarms", "shrink")
MARKS = (8, 16, 32, 64, 128, 256, 512, 1024)
FLIGHT_S = 60.0


def survival(found: Iterable[Found]) -> list[tuple[int, float]]:
    """Return the Kaplan-Meier curve: (flights, share of searches not yet successful), at every success."""
    searches = sorted(found, key=lambda one: (one.flights, not one.found))
    left, curve = 1.0, [(0, 1.0)]
    for index, one in enumerate(searches):
        if one.found:
            left *= 1.0 - 1.0 / (len(searches) - index)
            curve.append((one.flights, left))
    return curve


def share_found(curve: Sequence[tuple[int, float]], flights: int) -> float:
    """Return the share found after so many flights."""
    return 1.0 - [left for at, left in curve if at <= flights][-1]


def _search(job: tuple[str, str, int, int]) -> Found:
    return search(*job)


def recorded(path: Path | None, flights: int) -> dict[tuple[str, str, int], Found]:
    """Return the searches in the file of an earlier run that a search of so many flights need not repeat."""
    if path is None or not path.exists():
        return {}
    rows = [Found(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(one.defect, one.arm, one.rng_seed): one for one in rows if one.found or one.flights >= flights}


def searches(options: argparse.Namespace) -> Iterator[Found]:
    """Yield every search asked for, those already recorded first."""
    flights = max(1, int(options.hours * 3600 / FLIGHT_S))
    wanted = product(options.defects, options.arms, range(1, options.seeds + 1))
    done = recorded(options.out, flights)
    jobs = []
    for key in sorted(wanted, key=lambda key: key[2]):
        if key in done:
            yield done[key]
        else:
            jobs.append((*key, flights))
    if options.jobs == 1:
        yield from (_noted(_search(job), options.out) for job in jobs)
        return
    with get_context("spawn").Pool(options.jobs, die_with_parent, (os.getpid(),), maxtasksperchild=20) as pool:
        for one in pool.imap_unordered(_search, jobs):
            yield _noted(one, options.out)


def _noted(one: Found, path: Path | None) -> Found:
    state = "found" if one.found else "not found"
    sys.stderr.write(f"{one.defect} {one.arm} seed {one.rng_seed}: {state} after {one.flights} flights\n")
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(one._asdict()) + "\n")
    return one


def table(found: Sequence[Found]) -> dict[str, Any]:
    """Return the figures per arm and per defect and arm."""
    arms: dict[str, list[Found]] = defaultdict(list)
    cells: dict[str, dict[str, list[Found]]] = defaultdict(lambda: defaultdict(list))
    for one in found:
        arms[one.arm].append(one)
        cells[one.defect][one.arm].append(one)
    return {
        "arms": {
            arm: _figures(group) | equal_weight([cell[arm] for cell in cells.values() if arm in cell])
            for arm, group in arms.items()
        },
        "defects": {
            defect: {arm: _figures(group) for arm, group in groups.items()} for defect, groups in cells.items()
        },
    }


def equal_weight(groups: Sequence[Sequence[Found]]) -> dict[str, float]:
    """Return share found and median flights with every defect counted once, however many seeds it was searched with.

    A search that spent its budget counts as one that takes longer than any other, infinitely long.
    """
    shares = [sum(one.found for one in group) / len(group) for group in groups]
    medians = [median(one.flights if one.found else math.inf for one in group) for group in groups]
    return {"defects": len(groups), "share_equal_weight": mean(shares), "median_flights_equal_weight": median(medians)}


def _figures(group: Sequence[Found]) -> dict[str, Any]:
    curve = survival(group)
    return {
        "searches": len(group),
        "found": sum(one.found for one in group),
        "flights_max": max(one.flights for one in group),
        "median_rounds": median(one.rounds if one.found else float("inf") for one in group),
        "median_flights": median(one.flights if one.found else float("inf") for one in group),
        "median_simulated_h": median(one.simulated_h if one.found else float("inf") for one in group),
        "median_wall_s": round(median(one.wall_s for one in group), 2),
        "found_by_flights": {str(mark): round(share_found(curve, mark), 3) for mark in MARKS},
        "survival": [(at, round(left, 4)) for at, left in curve],
    }


def plot(figures: dict[str, Any], path: Path) -> None:
    """Draw the share of searches not yet successful over the flights flown, a line per arm, to a picture."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4.5), constrained_layout=True)
    for arm, group in figures["arms"].items():
        flights, left = zip(*group["survival"], strict=True)
        most = max(group["flights_max"], flights[-1])
        label = f"{arm} ({group['found']} of {group['searches']} found)"
        axes.step([*(max(1, at) for at in flights), most], [*left, left[-1]], where="post", label=label)
    axes.set(xscale="log", ylim=(0.0, 1.0), xlabel="flights", ylabel="share of searches without a find")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


# ---- false alarms -------------------------------------------------------------------------------------------------


def alarms(cases: int, rng_seed: int) -> dict[str, Any]:
    """Fly mutants of all policy campaigns with all defects off and judge them by every policy."""
    names = sorted(name for name in policy_campaigns(describe()) if name != "policy-all")
    checked, seen, endings = policy_names(), Counter[str](), Counter[str]()
    examples: dict[str, list[str]] = defaultdict(list)
    start, simulated_s, flown, alarmed = time.perf_counter(), 0.0, 0, 0
    for name in names:
        for case in _mutants(name, -(-cases // len(names)), rng_seed):
            record = fly_once(case)
            name, delivered = identity(case), record.delivered
            flight = Flight(test_case=name, flight_index=0, ending=record.ending, delivered=delivered)
            verdicts = judge(case, flight, record.trace, checked).verdicts
            broken = [verdict for verdict in verdicts if verdict.outcome == "violated"]
            flown, alarmed = flown + 1, alarmed + bool(broken)
            if flown % 100 == 0:
                sys.stderr.write(f"{flown} of {cases} cases flown, {alarmed} false alarms\n")
            simulated_s += record.trace.duration_s if record.trace else 0.0
            endings[record.ending] += 1
            for verdict in broken:
                seen[verdict.policy] += 1
                examples[verdict.policy].append(f"{name} {told_in_order(case.stimuli)}: {verdict.message}")
    wall_s = time.perf_counter() - start
    return {
        "cases": flown,
        "policies": len(checked),
        "false_alarms": alarmed,
        "by_policy": dict(seen),
        "endings": dict(endings),
        "simulated_h": round(simulated_s / 3600, 2),
        "times_real_time": round(simulated_s / wall_s, 1),
        "examples": {policy: texts[:3] for policy, texts in examples.items()},
    }


def _mutants(campaign: str, count: int, rng_seed: int) -> list[TestCase]:
    found = load_campaign(campaign)
    strategy = load_strategy(found.strategy.name)(
        template(found), dict(found.strategy.settings), found.policies, describe()
    )
    return strategy.ask(count, derive(rng_seed, "bench-alarms", campaign))


# ---- the command --------------------------------------------------------------------------------------------------


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench defects", description=__doc__)
    parser.add_argument("--part", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--defects", nargs="+", choices=sorted(TABLE), default=sorted(TABLE))
    parser.add_argument("--arms", nargs="+", choices=list(ARMS), default=list(ARMS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated time a search may take")
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--rng-seed", type=int, default=1, help="of the false-alarm and shrink cases")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="one JSON line a search, as it ends; those in it are not repeated")
    parser.add_argument("--plot", type=Path, help="draw the survival curves of the arms (needs matplotlib)")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    result: dict[str, Any] = {"seeds": options.seeds, "hours": options.hours}
    if "search" in options.part:
        result["search"] = table(list(searches(options)))
    if "alarms" in options.part:
        result["alarms"] = alarms(options.cases, options.rng_seed)
    if "shrink" in options.part:
        result["shrink"] = [one._asdict() for one in shrinks(options.defects, options.rng_seed)]
    if options.plot and "search" in result:
        plot(result["search"], options.plot)
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        _print(result, options)
    return 0


def _print(result: dict[str, Any], options: argparse.Namespace) -> None:
    if "search" in result:
        print(f"{options.seeds} seeds, at most {options.hours:g} h simulated a search; share found by so many flights")
        _print_search(result["search"])
    if "shrink" in result:
        _print_shrinks(result["shrink"])
    if "alarms" in result:
        _print_alarms(result["alarms"])


def _print_search(figures: dict[str, Any]) -> None:
    for arm, group in figures["arms"].items():
        steps = " ".join(f"{mark}:{share:.0%}" for mark, share in group["found_by_flights"].items())
        print(f"  {arm:10} {group['found']:4}/{group['searches']:<4} {group['median_flights']:7.0f}   {steps}")
        told = f"{group['share_equal_weight']:.0%} found, median {group['median_flights_equal_weight']:.1f} flights"
        print(f"  {'':10} each of {group['defects']} defects counted once: {told}")
    arms = list(figures["arms"])
    print("  found of searches, medians of flights, rounds (r) and wall time (s)")
    print(f"{'':30}" + "".join(f"{arm:>24}" for arm in arms))
    for defect, cells in sorted(figures["defects"].items()):
        texts = [_cell(cells[arm]) if arm in cells else "" for arm in arms]
        print(f"  {defect:28}" + "".join(f"{text:>24}" for text in texts))


def _cell(figures: dict[str, Any]) -> str:
    if math.isinf(figures["median_flights"]):
        return f"{figures['found']}/{figures['searches']} -"
    return (
        f"{figures['found']}/{figures['searches']} {figures['median_flights']:.0f} "
        f"{figures['median_rounds']:.0f}r {figures['median_wall_s']:.0f}s"
    )


def _print_shrinks(rows: list[dict[str, Any]]) -> None:
    times_s = [row["core_s"] for row in rows]
    told = f"median {median(times_s):.1f} s of one core, greatest {max(times_s):.1f} s"
    print(f"{len(rows)} cases of {INPUTS} inputs minimised: {told}")
    for row in rows:
        told = f"{row['inputs']} inputs (shortest known {row['trigger']}) after {row['flights']} flights"
        print(f"  {row['defect']:30} {told}, {row['core_s']:.1f} s of one core, {row['wall_s']:.1f} s in all")


def _print_alarms(figures: dict[str, Any]) -> None:
    print(
        f"{figures['false_alarms']} false alarms in {figures['cases']} cases, {figures['policies']} policies "
        f"({figures['simulated_h']} h simulated, {figures['times_real_time']:.0f} x real time with judging)"
    )
    for policy, texts in figures["examples"].items():
        print(f"  {policy}: {figures['by_policy'][policy]}")
        for text in texts:
            print(f"    {text}")
