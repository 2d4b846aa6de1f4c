"""`scripts/bench defects`: false alarms with all planted defects off, and how soon a trigger is minimised.

    scripts/bench defects [--part alarms shrink three] [--defects NAME ...] [--cases 2000] [--rng-seed 1]
                          [--budget 200] [--out FILE.jsonl] [--json]

alarms: mutants of all policy campaigns flown with all defects off and judged by all policies; every violation is a
false alarm.
shrink: the shortest known trigger of each defect, hidden among random inputs (twenty in all), is minimised on one core.
three: `policy-all` with three defects on, drawn by the seed: which are found, told apart and made small, at what cost.

How soon each defect is found: `scripts/bench search`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path
from statistics import median
from typing import Any

from _defect_campaign import three
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

PARTS = ("alarms", "shrink", "three")


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
    parser.add_argument("--part", nargs="+", choices=PARTS, default=["alarms", "shrink"])
    parser.add_argument("--defects", nargs="+", choices=sorted(TABLE), default=sorted(TABLE))
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--rng-seed", type=int, default=1, help="of the false-alarm and shrink cases")
    parser.add_argument("--budget", type=int, default=200, help="first flights of `three`")
    parser.add_argument("--out", type=Path, help="the row of `three` is added to it")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    result: dict[str, Any] = {}
    if "alarms" in options.part:
        result["alarms"] = alarms(options.cases, options.rng_seed)
    if "shrink" in options.part:
        result["shrink"] = [one._asdict() for one in shrinks(options.defects, options.rng_seed)]
    if "three" in options.part:
        result["three"] = three(options.rng_seed, options.budget)._asdict()
        if options.out:
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(result["three"]) + "\n")
    if options.json or "three" in result:
        print(json.dumps(result, indent=2))
    else:
        _print(result)
    return 0


def _print(result: dict[str, Any]) -> None:
    if "shrink" in result:
        _print_shrinks(result["shrink"])
    if "alarms" in result:
        _print_alarms(result["alarms"])


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
