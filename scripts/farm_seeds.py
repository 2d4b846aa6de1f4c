"""Run the simulated farm for many seeds, or one seed again: `scripts/farm --seeds 3000`, `scripts/farm --seed 17`.

A seed decides every fault: lost, doubled and late messages, partitions, dying and freezing workers and books, a full
disk, babbling scorers, lies. A seed that fails prints its replay command. `--bug NAME` plants a bug first.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import multiprocessing
import os
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent


def main() -> int:
    """Run what was asked for; 0 if every check held."""
    sys.path.insert(0, str(HERE.parent / "tests" / "farm"))
    options = _options()
    logging.disable(logging.CRITICAL)
    seeds = [options.seed] if options.seed is not None else list(range(options.first, options.first + options.seeds))
    started_s = time.monotonic()
    work = [(seed, options.bug) for seed in seeds]
    if len(seeds) == 1:
        results = [_run(work[0])]
    else:
        with multiprocessing.Pool(options.jobs) as pool:
            results = pool.map(_run, work, chunksize=8)
    failed = [(seed, text) for seed, text, _, _ in results if text]
    for seed, text in failed[:10]:
        bug = f" --bug {options.bug}" if options.bug else ""
        print(f"seed {seed}: {text}\n  replay: scripts/farm --seed {seed}{bug}")
    faults, steps = sum(result[2] for result in results), sum(result[3] for result in results)
    took_s = time.monotonic() - started_s
    print(f"{len(seeds)} seeds, {len(failed)} failed, {faults} faults, {steps} steps, {took_s:.1f} s")
    return 1 if failed else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=1000, help="how many seeds")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seed", type=int, help="run this seed alone")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--bug", default="", help="plant a bug (see tests/farm/farm_bugs.py)")
    return parser.parse_args()


def _run(work: tuple[int, str]) -> tuple[int, str, int, int]:
    from farm_bugs import BUGS
    from farm_world import know_the_clean_finds, run_seed

    seed, bug = work
    logging.disable(logging.CRITICAL)
    if bug:
        know_the_clean_finds()
    with BUGS[bug]() if bug else contextlib.nullcontext():
        try:
            report = run_seed(seed)
        except Exception as fault:  # noqa: BLE001 (whatever breaks is a failed seed)
            return seed, f"{type(fault).__name__}: {fault}", 0, 0
    return seed, "", report.faults, report.steps


if __name__ == "__main__":
    sys.exit(main())
