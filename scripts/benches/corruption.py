"""Flips a byte in, and cuts, every 512-byte block of a small run's books in turn: is each told, or harmless?

Once for a run that ended, once for one whose books were killed, with all they have in the write-ahead log.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent


def main(argv: list[str]) -> int:
    """Damage and print; 1 if any damage was silent."""
    parser = argparse.ArgumentParser(prog="scripts/bench corruption", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=5, help="budget of the run")
    parser.add_argument("--step", type=int, default=1, help="take only every so many faults")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(argv)
    sys.path.insert(0, str(HERE.parents[1] / "tests" / "unit" / "campaign"))
    figures: Counter[str] = Counter({"faults": 0, "told": 0, "harmless": 0, "silent": 0})
    with tempfile.TemporaryDirectory() as folder:
        for name in ("ended", "killed"):
            figures += _measured(Path(folder), name, options)
    if options.json:
        print(json.dumps(figures))
    else:
        for name, value in {"silent": 0, **figures}.items():
            print(f"{name:10} {value:,}")
    return int(figures["silent"] > 0)


def _measured(folder: Path, name: str, options: argparse.Namespace) -> Counter[str]:
    import books_corruption as corruption

    run_dir = corruption.small_run(folder / name, killed=name == "killed", flights=options.flights)
    whole, counts = corruption.whole_of(run_dir, folder / "whole"), Counter[str]()
    for fault in list(corruption.faults(run_dir))[:: options.step]:
        outcome = corruption.outcome_of(fault, run_dir, folder / "damaged", whole)
        counts.update(("faults", outcome))
        if outcome == "silent":
            print(f"silent: {name}, {fault}", file=sys.stderr)
    return counts


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
