"""`scripts/bench phases`: of the phases written for a rule, in how many does it apply, and what do the others lack?

    scripts/bench phases [--arms all random] [--rng-seeds 1] [--budget 150] [--out FILE.jsonl] [--json]

A clean search of `policy-all` in one process, nothing planted. A rule that never applies finds nothing: what its phases
lack is where a search is to be mended.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from _rows import handed_out
from _search_phases import phases
from _search_run import ARMS


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench phases", description=__doc__.splitlines()[0])
    parser.add_argument("--arms", nargs="+", choices=list(ARMS), default=["all"])
    parser.add_argument("--rng-seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--budget", type=int, default=150)
    parser.add_argument("--out", type=Path, help="one JSON line a search is added")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    rows = [phases(arm, seed, options.budget) for arm in options.arms for seed in options.rng_seeds]
    if handed_out(rows, options.out, as_json=options.json):
        return 0
    for row in rows:
        print(f"{row['arm']} {row['rng_seed']}: rules applied in {row['applied_share']:.1%} of verdicts")
        for policy, one in sorted(row["rules"].items(), key=lambda item: item[1]["applied"] / item[1]["phases"]):
            print(f"    {policy:26} {one['applied']:3} of {one['phases']:3}  {one['lacking']}")
    return 0
