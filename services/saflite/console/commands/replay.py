"""Fly again what was found and compare the traces bit by bit.

Takes a run folder (every confirmed violation), a recording, or a test case (flown twice). Where flights of the target
repeat only statistically, each is flown five times and how many violate is told. Exit code 0: nothing is violated any
more; 1: violated again, or the run holds violations neither confirmed nor refuted (`--all` flies them, too); 3: a
flight differs from its record though its target repeats bit by bit.

examples:
  saflite replay runs/avoidance-m2
  saflite replay runs/avoidance-m2 --violation 3f2a
  saflite replay runs/avoidance-m2/recordings/8c1d2f-0.mcap
  saflite replay case.yaml
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    words = "run folder (the newest), recording (.mcap) or test case (.yaml, .json)"
    parser.add_argument("what", type=Path, nargs="?", metavar="RUN", help=words)
    parser.add_argument(
        "--violation", default="", metavar="ID", help="only this fingerprint or test case (or its start)"
    )
    parser.add_argument("--all", action="store_true", help="those flaky, unconfirmed or not yet flown again, too")
    arguments.add_policy(parser, "judge a test case by this policy")
    parser.add_argument("--times", type=int, help="how often to fly each (1; 5 where flights differ by nature)")
    arguments.add_wall_limit(parser)
    arguments.add_anywhere(parser)
    arguments.add_modules(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object per flight")


def run(args: argparse.Namespace) -> int:
    """Fly everything again and compare."""
    from saflite.console.io import campaign_options
    from saflite.console.operations import replaying
    from saflite.console.run_data import farm_lookup, provenance
    from saflite.console.run_data.run_folder import tell_loss
    from saflite.console.run_data.unproven import unproven_words
    from saflite.console.view import out
    from saflite.runtime import run_modules

    args.what = farm_lookup.newest(args.what)
    if args.times is not None:
        campaign_options.at_least("--times", args.times, 1)
    if args.what.is_dir():
        tell_loss(args.what)
        run_modules.use(args.what, args.module)
    entries = replaying.entries(args.what, args.violation, args.all, tuple(args.policy), args.anywhere)
    results = []
    for result in replaying.replay(entries, args.times, args.wall_limit):
        results.append(result)
        out.json(result._asdict()) if args.json else out.line(replaying.line(result))
        out.flush()
    if not args.json:
        out.line(replaying.conclusion(results))
    left = 0 if args.violation else replaying.left_out(args.what, entries)
    if left:
        out.complain("note", f"{unproven_words(left)}; `--all` flies them, too")
    change = provenance.differs(args.what) if args.what.is_dir() else ""
    exact = not any(replaying.differs(result) for result in results)
    if change and not (exact and all(result.repeats == "bitwise" for result in results)):
        out.complain("note", f"other code flew this run: {change}; what it found may not show under this code")
    return int(bool(left) or any(result.violated for result in results)) if exact else 3
