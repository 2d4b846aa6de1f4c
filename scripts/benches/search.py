"""`scripts/bench search`: how many faults does a search find that nobody told it of, and what did it expose?

    scripts/bench search [--set fit report blind clean ...] [--arms all own pgfuzz random unscored] [--together 1]
                         [--faults NAME ... [--policy ID]] [--rng-seeds 1 2 3] [--budget 200] [--blind-faults 12]
                         [--blind-seed 1] [--jobs 1] [--out FILE.jsonl] [--json]
    scripts/bench search --page         # writes deploy/docs/defects.md from the rows in results/search*.jsonl

Ground truth: a fault is found by a confirmed violation that its test case shows again with this fault alone and not
without any. `fit` and `report` are the planted defects, parted by a hash of their names: settings may be fitted on the
first, figures are given for the second. `authored-fit`, `authored-report`: faults written by hand for this bench
(`data/authored_faults.toml`), parted likewise. `blind`: faults drawn blindly from the lines of the reference autopilot
(`_blind_faults.py`); `clean`: no fault, for exposure and false alarms. `--together` plants so many defects at once; a
search ends when all are found, or with its budget of flights, re-flights included; what is not found counts as such.
`--faults` names planted and hand-written ones, those of `data/rule_faults.toml` too, that are all on at once, in place
of a set; `--policy` whose campaign the arms of one policy fly for them.
Searches that stand in the `--out` file already are not run again. In-process campaigns, real books, flights, oracle.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean
from typing import Any

import _search_page
import numpy as np
from _authored_faults import Patch, authored
from _blind_faults import drawn
from _bootstrap import bootstrap_95
from _rule_faults import rule_faults
from _search_run import ARMS, OF_ONE_POLICY, Job, Row, search

from saflite.contract.rng import derive
from saflite.flight.autopilots.reference.defects import TABLE
from saflite.oracle.policy import policy_names
from saflite.simulator_worker.processes import die_with_parent

SETS = ("fit", "report", "authored-fit", "authored-report", "blind", "clean")
AUTHORED = "authored-"
HERE = Path(__file__).resolve().parent
ROWS = HERE / "results"
PAGE = HERE.parents[1] / "deploy" / "docs" / "defects.md"


def half(name: str) -> str:
    """Return the set a planted defect belongs to, by a fixed hash of its name."""
    return ("fit", "report")[hashlib.sha256(name.encode()).digest()[0] % 2]


def one_line() -> dict[str, Patch]:
    """Return every fault that is one changed line: written for this bench, or for the rules (`--part planted`)."""
    return {**{name: one.patch for name, one in rule_faults().items()}, **authored()}


def named(options: argparse.Namespace) -> Iterator[Job]:
    """Yield the searches for the faults named, all of which are on."""
    defects = tuple(name for name in options.faults if name in TABLE)
    lines = tuple(one_line()[name] for name in options.faults if name not in TABLE)
    for arm in options.arms:
        for rng_seed in options.rng_seeds:
            yield Job(arm, defects, lines, rng_seed, options.budget, options.policy)


def members(which: str, options: argparse.Namespace) -> Iterator[Job]:
    """Yield the searches of a set for every arm and seed."""
    for arm in options.arms:
        for rng_seed in options.rng_seeds:
            if which == "clean":
                yield Job(arm, (), (), rng_seed, options.budget)
            elif which == "blind":
                for site in drawn(options.blind_seed, options.blind_faults):
                    yield Job(arm, (), (site,), rng_seed, options.budget)
            elif which.startswith(AUTHORED):
                patches = [patch for patch in authored().values() if half(patch.name) == which.removeprefix(AUTHORED)]
                for lines in groups(patches, options.together):
                    yield Job(arm, (), lines, rng_seed, options.budget)
            else:
                names = sorted((name for name in TABLE if half(name) == which), key=_mixed)
                size = 1 if arm in OF_ONE_POLICY else options.together
                for first in range(0, len(names), size):
                    group = tuple(names[first : first + size])
                    yield Job(arm, group, (), rng_seed, options.budget)


def groups(patches: Sequence[Patch], size: int) -> list[tuple[Patch, ...]]:
    """Return the faults in groups that can be planted together: no two in one function, order mixed."""
    found: list[list[Patch]] = []
    for patch in sorted(patches, key=lambda one: _mixed(one.name)):
        places = (group for group in found if len(group) < size)
        fits = (group for group in places if all(one.function != patch.function for one in group))
        group = next(fits, None)
        if group is None:
            found.append([patch])
        else:
            group.append(patch)
    return [tuple(group) for group in found]


def _mixed(name: str) -> str:
    return hashlib.sha256(f"order {name}".encode()).hexdigest()


def key_of(job: Job) -> tuple[Any, ...]:
    """Return what a row of the file goes by."""
    return job.arm, (*job.defects, *(line.name for line in job.lines)), job.rng_seed, job.budget, job.policy


def rows_of(path: Path | None) -> dict[tuple[Any, ...], Row]:
    """Return the searches that stand in a file."""
    if path is None or not path.exists():
        return {}
    rows = [Row(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]
    return {(row.arm, tuple(row.faults), row.rng_seed, row.budget, row.policy): row for row in rows}


def rows(folder: Path) -> list[Row]:
    """Return the searches that stand in a folder's files, one for each search."""
    known = {key: row for path in sorted(folder.glob("search*.jsonl")) for key, row in rows_of(path).items()}
    return list(known.values())


def page(found: Sequence[Row]) -> str:
    """Return the page of the planted defects in Markdown."""
    return _search_page.page(found, {name: half(name) for name in TABLE})


def run(options: argparse.Namespace) -> list[Row]:
    """Run what is not in the file yet; return all rows asked for."""
    jobs = list(named(options)) if options.faults else [job for one in options.set for job in members(one, options)]
    known = rows_of(options.out)
    todo = [job for job in jobs if key_of(job) not in known]
    with get_context("spawn").Pool(options.jobs, die_with_parent, (os.getpid(),)) as pool:
        for row in pool.imap_unordered(search, todo):
            known[row.arm, tuple(row.faults), row.rng_seed, row.budget, row.policy] = row
            said = f"found {row.found} in {row.flights} flights, false alarms {row.false_alarms}"
            sys.stderr.write(f"{row.arm} {' '.join(row.faults)} {row.rng_seed}: {said}\n")
            if options.out:
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row._asdict()) + "\n")
    return [known[key_of(job)] for job in jobs]


def table(rows: Sequence[Row]) -> dict[str, Any]:
    """Return per arm: faults found of those planted, with an interval over searches, and what was exposed."""
    return {arm: figures([row for row in rows if row.arm == arm]) for arm in dict.fromkeys(row.arm for row in rows)}


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the figures of one arm; every search counts alike, unfinished ones included."""
    planted = sum(len(row.faults) for row in rows)
    shares = np.array([len(row.found) / len(row.faults) for row in rows if row.faults])
    low, high = bootstrap_95(lambda index: float(shares[index].mean()), len(shares), derive(1, "bench search"))
    return {
        "searches": len(rows),
        "faults": planted,
        "found": sum(len(row.found) for row in rows),
        "share": round(float(shares.mean()), 3) if len(shares) else None,
        "share_95": [round(low, 3), round(high, 3)],
        "applied_share": round(fmean(row.applied_share for row in rows), 3),
        "flights_a_rule_spoke_in": round(fmean(row.spoke_share for row in rows), 3),
        "silent_rules": round(fmean(len(row.silent) for row in rows), 1),
        "states": round(fmean(row.states for row in rows), 1),
        "false_alarms": sum(sum(row.false_alarms.values()) for row in rows),
        "flights": sum(row.flights for row in rows),
        "by_fault": {
            fault: f"{sum(fault in row.found for row in mine)}/{len(mine)}"
            for fault in sorted({fault for row in rows for fault in row.faults})
            for mine in [[row for row in rows if fault in row.faults]]
        },
    }


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench search", description=__doc__.splitlines()[0])
    parser.add_argument("--set", nargs="+", choices=SETS, default=["report"])
    parser.add_argument(
        "--faults", nargs="+", choices=[*TABLE, *one_line()], metavar="NAME", help="all on at once, in place of a set"
    )
    parser.add_argument("--policy", choices=policy_names(), default="", metavar="ID", help="whose own campaign flies")
    parser.add_argument("--arms", nargs="+", choices=list(ARMS), default=["all", "pgfuzz", "random"])
    parser.add_argument("--together", type=int, default=1, help="planted defects that are on at once")
    parser.add_argument("--rng-seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--budget", type=int, default=200)
    parser.add_argument("--blind-faults", type=int, default=12)
    parser.add_argument("--blind-seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, help="one JSON line a search; those in it are not repeated")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--page", action="store_true", help="write the page from the rows, run nothing")
    options = parser.parse_args(argv)
    if (
        options.faults
        and not options.policy
        and set(options.faults) - set(TABLE)
        and set(options.arms) & set(OF_ONE_POLICY)
    ):
        parser.error(
            f"the arms {', '.join(OF_ONE_POLICY)} need --policy ID for a changed line, which has none of its own"
        )
    if options.page:
        PAGE.write_text(page(rows(ROWS)), encoding="utf-8")
        return 0
    result = table(run(options))
    if options.json:
        print(json.dumps(result, indent=2))
        return 0
    for arm, group in result.items():
        share = "" if group["share"] is None else f"{group['found']} of {group['faults']} found ({group['share']:.0%}"
        interval = f", 95 % {group['share_95'][0]:.0%} to {group['share_95'][1]:.0%}); " if share else ""
        print(
            f"{arm:9} {share}{interval}rules applied in {group['applied_share']:.1%} of verdicts, "
            f"{group['silent_rules']} rules silent, {group['states']} states, {group['false_alarms']} false alarms"
        )
        for fault, found in group["by_fault"].items():
            print(f"    {fault:60} {found}")
    return 0
