"""Make a run smaller: keep one recording of each behaviour, let go of other traces, recordings and files left.

What goes can be flown again bit by bit: `saflite export RUN --recording TEST_CASE`. A run of a target whose flights
differ by nature is refused without `--for-good`. The books stay whole: nothing found, judged or replayed changes.

examples:
  saflite prune runs/night --dry-run
  saflite prune runs/night --max-mb 10
"""

from __future__ import annotations

import argparse

MB = 1e6


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    arguments.add_run(parser, "the newest at rest")
    parser.add_argument("--max-mb", type=float, metavar="MB", help="let go of the least bad finds, too, down to this")
    parser.add_argument("--for-good", action="store_true", help="also what cannot be flown again bit by bit")
    parser.add_argument("--dry-run", action="store_true", help="only say what would go")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Prune and say what is left; 0 once it is done."""
    from saflite.campaign.storage.prune import prune
    from saflite.console.io import campaign_options
    from saflite.console.run_data import farm_lookup
    from saflite.console.run_data.run_folder import open_run
    from saflite.console.view import out
    from saflite.contract.errors import Refused

    if args.max_mb is not None:
        campaign_options.at_least("--max-mb", args.max_mb, 0.0)
    args.run = farm_lookup.newest_at_rest(args.run)
    with open_run(args.run) as folder:
        repeats = folder.target.repeats
    if repeats != "bitwise" and not args.for_good:
        fix = "--for-good lets go of it all the same"
        raise Refused(
            "run folder", where=str(args.run), expected="flights that repeat bit by bit", got=repeats, fix=fix
        )
    limit = None if args.max_mb is None else int(args.max_mb * MB)
    done = prune(args.run, limit, dry=args.dry_run)
    if args.json:
        out.json(done._asdict())
        return 0
    would = "would go from" if args.dry_run else "went from"
    out.line(f"{args.run}: blobs {would} {done.before_bytes / MB:.1f} to {done.after_bytes / MB:.1f} MB")
    out.line(f"{done.recordings} recordings of {done.behaviours} behaviours stay")
    return 0
