"""`scripts/bench reach`: what the test cases of a search reach of faults it never saw, and what of that rules see.

    scripts/bench reach [--arms all random] [--rng-seeds 1] [--cases 60] [--faults NAME ... | --drawn 40 --draw-seed 1]
                        [--jobs 2] [--out FILE.jsonl] [--json]

A search of `policy-all` with nothing planted proposes test cases. Each is flown with each fault of
`data/rule_faults.toml` alone: does the flight differ from the one without it (the fault is reached and acts), and which
rules are broken that are not without it? No search learns of any fault, so what it costs to find one is read from the
shares. `--drawn` takes that many of the faults that some rule sees in a flight made for them
(`results/rules-planted.jsonl`).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from functools import cached_property
from math import comb
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from _blind_faults import planted
from _inline import Inline
from _rows import handed_out
from _rule_faults import rule_faults
from _search_run import ARMS, Faulty, Job, campaign_of

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight, Trace
from saflite.contract.rng import derive
from saflite.contract.test_case import TestCase, identity
from saflite.oracle.judge import judge
from saflite.oracle.policy import policy_names

PLANTED = Path(__file__).parent / "results" / "rules-planted.jsonl"
AFTER = (20, 50)  # flights after which the table tells how many faults are found


class Pair(NamedTuple):
    """A fault and a test case."""

    fault: str
    case: TestCase


class Reached(NamedTuple):
    """What became of a pair: the flight differs, and rules broken by the fault alone."""

    fault: str
    differs: bool
    seen_by: tuple[str, ...]


def proposed(arm: str, rng_seed: int, cases: int) -> list[TestCase]:
    """Return the test cases that a search flies first, nothing planted."""
    flights = Faulty(())
    with tempfile.TemporaryDirectory(prefix="saflite-reach-") as folder:
        inline = Inline(campaign_of(Job(arm, (), (), rng_seed, cases)), Path(folder) / "run", flights)
        inline.run(lambda _: False)
        inline.close()
    return list(flights.cases.values())[:cases]


class Flown:
    """A flight, and the rules it breaks once somebody asks."""

    def __init__(self, case: TestCase) -> None:
        self._case = case
        self._record = fly_once(case)
        self.trace: Trace | None = self._record.trace

    @cached_property
    def broken(self) -> frozenset[str]:
        """The rules it breaks: none where there is no trace."""
        if self.trace is None:
            return frozenset()
        flight = Flight(test_case="", flight_index=0, ending=self._record.ending, delivered=self._record.delivered)
        verdicts = judge(self._case, flight, self.trace, policy_names()).verdicts
        return frozenset(one.policy for one in verdicts if one.outcome == "violated")


class Pairs:
    """Flies pairs; the flight without any fault is kept for the next pair, mostly of the same test case."""

    def __init__(self) -> None:
        self._of = ""
        self._clean: Flown | None = None

    def reach(self, pair: Pair) -> Reached:
        """Fly a test case with a fault; judged is what differs from the flight without it."""
        if self._clean is None or self._of != identity(pair.case):
            self._of, self._clean = identity(pair.case), Flown(pair.case)
        with planted([rule_faults()[pair.fault].patch]):
            faulty = Flown(pair.case)
        if faulty.trace is not None and self._clean.trace is not None and not _differ(self._clean.trace, faulty.trace):
            return Reached(pair.fault, differs=False, seen_by=())
        return Reached(pair.fault, differs=True, seen_by=tuple(sorted(faulty.broken - self._clean.broken)))


PAIRS = Pairs()  # one in each process


def reach(pair: Pair) -> Reached:
    """Fly a pair in this process."""
    return PAIRS.reach(pair)


def _differ(one: Trace, other: Trace) -> bool:
    if one.samples != other.samples or one.signals != other.signals:
        return True
    return any(not np.array_equal(one.array(name), other.array(name), equal_nan=True) for name in one.signals)


def drawn(count: int, seed: int) -> list[str]:
    """Return faults by lot, of those that some rule sees in the flight made for them."""
    rows = [json.loads(line) for line in PLANTED.read_text(encoding="utf-8").splitlines()]
    seen = sorted(row["fault"] for row in rows if row["seen_by"])
    return sorted(derive(seed, "reach").choice(seen, min(count, len(seen)), replace=False).tolist())


def measured(arm: str, rng_seed: int, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return a row a fault: in how many flights it acts, in how many a rule sees it, and which rules how often."""
    cases = proposed(arm, rng_seed, options.cases)
    names = options.faults or drawn(options.drawn, options.draw_seed)
    pairs = [Pair(name, case) for case in cases for name in names]
    found: list[Reached] = []
    with get_context("fork").Pool(options.jobs) as pool:
        for one in pool.imap(reach, pairs, chunksize=len(names)):
            found.append(one)
            if len(found) % len(names) == 0:
                sys.stderr.write(f"{arm} {rng_seed}: {len(found) // len(names)} of {len(cases)} test cases\n")
    rows = []
    for name in names:
        mine = [one for one in found if one.fault == name]
        by = Counter(policy for one in mine for policy in one.seen_by)
        counts = {"differs": sum(one.differs for one in mine), "seen": sum(bool(one.seen_by) for one in mine)}
        rows.append({"arm": arm, "rng_seed": rng_seed, "cases": len(cases), "fault": name, **counts, "by": dict(by)})
    return rows


def found_after(flights: int, rows: Sequence[dict[str, Any]], what: str) -> float:
    """Return how many of the faults that many of the flights, drawn by lot, show at least once."""
    each = (comb(row["cases"] - row[what], flights) / comb(row["cases"], flights) for row in rows)
    return sum(1.0 - missed for missed in each)


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench reach", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--arms", nargs="+", choices=[arm for arm in ARMS if arm in ("all", "random", "unscored", "pgfuzz")]
    )
    parser.add_argument("--rng-seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--faults", nargs="+", choices=list(rule_faults()), metavar="NAME")
    parser.add_argument("--drawn", type=int, default=40)
    parser.add_argument("--draw-seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--code", default="", help="what the rows are to say of the code, a commit mostly")
    parser.add_argument("--out", type=Path, help="one JSON line a fault is added")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    rows = [
        {"code": options.code, **row}
        for arm in options.arms or ["all"]
        for rng_seed in options.rng_seeds
        for row in measured(arm, rng_seed, options)
    ]
    if handed_out(rows, options.out, as_json=options.json):
        return 0
    for row in sorted(rows, key=lambda row: row["seen"]):
        print(f"{row['arm']:9} {row['rng_seed']:5} {row['fault']:44} acts {row['differs']:3}, seen {row['seen']:3}")
    for flights in (count for count in AFTER if all(count <= row["cases"] for row in rows)):
        seen, acts = (found_after(flights, rows, what) for what in ("seen", "differs"))
        print(f"after {flights} flights: {seen:.1f} of {len(rows)} seen, {acts:.1f} acted")
    return 0
