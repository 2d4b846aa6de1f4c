"""`scripts/bench defects`: how soon is each planted defect found, and are there false alarms?

    scripts/bench defects [--part search alarms] [--defects NAME ...] [--arms NAME ...] [--seeds 20] [--hours 24]
                          [--cases 2000] [--jobs 1] [--out FILE.json] [--json]

search: for each defect, arm and seed the campaign of the defect's policy runs to its first confirmed violation, or
until `--hours` of simulated time are spent (a flight counts as its full minute). Told are rounds, flights, simulated
and wall time, and survival curves (the share not yet found after so many flights), censored searches counted as such.
alarms: mutants of all policy campaigns flown with all defects off and judged by all policies; every violation is a
false alarm. The full table (20 seeds, 24 h) takes days on one core: `--seeds`, `--hours`, `--arms` cut it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

from _defect_search import ARMS, Found, search

from saflite.campaign.builtin import load_campaign, template
from saflite.campaign.policy_campaigns import policy_campaigns
from saflite.contract.flight import Flight
from saflite.contract.rng import derive
from saflite.contract.test_case import TestCase, identity
from saflite.flight.autopilots.reference.defects import TABLE
from saflite.mutator.strategies.pgfuzz import Strategy
from saflite.oracle.judge import judge
from saflite.oracle.policy import policy_names
from saflite.simulator_worker.processes import die_with_parent
from saflite.simulator_worker.targets import reference

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


def searches(options: argparse.Namespace) -> Iterator[Found]:
    """Yield every search asked for."""
    flights = max(1, int(options.hours * 3600 / FLIGHT_S))
    jobs = [
        (defect, arm, seed, flights)
        for seed in range(1, options.seeds + 1)
        for defect in options.defects
        for arm in options.arms
    ]
    if options.jobs == 1:
        yield from map(_search, jobs)
        return
    with get_context("spawn").Pool(options.jobs, die_with_parent, (os.getpid(),), maxtasksperchild=20) as pool:
        yield from pool.imap_unordered(_search, jobs)


def table(found: Sequence[Found]) -> dict[str, Any]:
    """Return the figures per arm and per defect and arm."""
    arms: dict[str, list[Found]] = defaultdict(list)
    cells: dict[str, dict[str, list[Found]]] = defaultdict(lambda: defaultdict(list))
    for one in found:
        arms[one.arm].append(one)
        cells[one.defect][one.arm].append(one)
    return {
        "arms": {arm: _figures(group) for arm, group in arms.items()},
        "defects": {
            defect: {arm: _figures(group) for arm, group in groups.items()} for defect, groups in cells.items()
        },
    }


def _figures(group: Sequence[Found]) -> dict[str, Any]:
    curve = survival(group)
    return {
        "searches": len(group),
        "found": sum(one.found for one in group),
        "median_rounds": median(one.rounds if one.found else float("inf") for one in group),
        "median_flights": median(one.flights if one.found else float("inf") for one in group),
        "median_simulated_h": median(one.simulated_h if one.found else float("inf") for one in group),
        "median_wall_s": round(median(one.wall_s for one in group), 2),
        "found_by_flights": {str(mark): round(share_found(curve, mark), 3) for mark in MARKS},
        "survival": [(at, round(left, 4)) for at, left in curve],
    }


# ---- false alarms -------------------------------------------------------------------------------------------------


def alarms(cases: int, rng_seed: int) -> dict[str, Any]:
    """Fly mutants of all policy campaigns with all defects off and judge them by every policy."""
    names = sorted(name for name in policy_campaigns() if name != "policy-all")
    checked, seen, endings = policy_names(), Counter[str](), Counter[str]()
    examples: dict[str, list[str]] = defaultdict(list)
    start, simulated_s, flown, alarmed = time.perf_counter(), 0.0, 0, 0
    for name in names:
        for case in _mutants(name, -(-cases // len(names)), rng_seed):
            record = reference.fly(case, lambda: False)
            flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending)
            verdicts = judge(case, flight, record.trace, checked).verdicts
            broken = [verdict for verdict in verdicts if verdict.outcome == "violated"]
            flown, alarmed = flown + 1, alarmed + bool(broken)
            simulated_s += record.trace.duration_s if record.trace else 0.0
            endings[record.ending] += 1
            for verdict in broken:
                seen[verdict.policy] += 1
                examples[verdict.policy].append(f"{name} {_told(case)}: {verdict.message}")
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
    strategy = Strategy(template(found), found.strategy.settings, found.policies)
    return strategy.ask(count, derive(rng_seed, "bench-alarms", campaign))


def _told(case: TestCase) -> str:
    return "; ".join(
        f"{one.at_s:g} s {one.kind} {one.name} {' '.join(f'{value:g}' for value in one.values)}" for one in case.stimuli
    )


# ---- the command --------------------------------------------------------------------------------------------------


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench defects", description=__doc__)
    parser.add_argument("--part", nargs="+", choices=("search", "alarms"), default=["search", "alarms"])
    parser.add_argument("--defects", nargs="+", choices=sorted(TABLE), default=sorted(TABLE))
    parser.add_argument("--arms", nargs="+", choices=list(ARMS), default=list(ARMS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated time a search may take")
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--rng-seed", type=int, default=1, help="of the false-alarm cases")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="write every search as a JSON line, as it ends")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    result: dict[str, Any] = {"seeds": options.seeds, "hours": options.hours}
    if "search" in options.part:
        result["search"] = table(list(_noted(searches(options), options.out)))
    if "alarms" in options.part:
        result["alarms"] = alarms(options.cases, options.rng_seed)
    if options.json:
        print(json.dumps(result, indent=2))
    else:
        _print(result, options)
    return 0


def _noted(found: Iterator[Found], path: Path | None) -> Iterator[Found]:
    for number, one in enumerate(found, start=1):
        state = "found" if one.found else "not found"
        sys.stderr.write(f"{number}: {one.defect} {one.arm} seed {one.rng_seed}: {state} after {one.flights} flights\n")
        if path is not None:
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(one._asdict()) + "\n")
        yield one


def _print(result: dict[str, Any], options: argparse.Namespace) -> None:
    if "search" in result:
        print(
            f"{options.seeds} seeds, at most {options.hours:g} h simulated a search; found of searches, median flights"
        )
        for arm, figures in result["search"]["arms"].items():
            steps = " ".join(f"{mark}:{share:.0%}" for mark, share in figures["found_by_flights"].items())
            print(
                f"  {arm:10} {figures['found']:4}/{figures['searches']:<4} {figures['median_flights']:7.0f}   {steps}"
            )
        arms = list(result["search"]["arms"])
        print(f"{'':32}" + "".join(f"{arm:>16}" for arm in arms))
        for defect, cells in sorted(result["search"]["defects"].items()):
            texts = [f"{c['found']}/{c['searches']} {c['median_flights']:.0f}" for c in (cells[arm] for arm in arms)]
            print(f"  {defect:30}" + "".join(f"{text:>16}" for text in texts))
    if "alarms" in result:
        figures = result["alarms"]
        print(
            f"{figures['false_alarms']} false alarms in {figures['cases']} cases, {figures['policies']} policies "
            f"({figures['simulated_h']} h simulated, {figures['times_real_time']:.0f} x real time with judging)"
        )
        for policy, texts in figures["examples"].items():
            print(f"  {policy}: {figures['by_policy'][policy]}")
            for text in texts:
                print(f"    {text}")
