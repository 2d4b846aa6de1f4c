"""Fly one test case many times under other noise and tell how often it violates, with the interval of the rate.

CASE is a test case (.yaml, .json), a recording, a file of a corpus, or a run folder with `--violation`. No campaign
flies the noises that are counted, so the rate is not that of the flights by which it was found; one flight more, under
the noise of its record, is told apart. So are flights that say nothing of the vehicle. Exit code 0: never violated;
1: violated; 3: no flight counted could be judged.

examples:
  saflite flake runs/avoidance-m2 --violation 3f2a -n 20
  saflite flake case.yaml -n 50 --policy min-obstacle-distance
  saflite flake case.json -n 20 --policy a-chute --target "reference+parachute-in-acro"
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("case", type=Path, help="test case, recording, file of a corpus, or run folder")
    parser.add_argument("-n", type=int, default=20, metavar="N", help="flights that are counted (20)")
    parser.add_argument("--violation", default="", metavar="ID", help="of a run: this fingerprint or test case")
    arguments.add_policy(parser, "judge by this policy")
    parser.add_argument(
        "--target", default="", metavar="BUILD", help="fly on this build (see `saflite regress --help`)"
    )
    arguments.add_wall_limit(parser)
    arguments.add_anywhere(parser)
    arguments.add_modules(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Fly and count."""
    from saflite.console.io import campaign_options
    from saflite.console.operations import builds, flaking
    from saflite.console.run_data import known
    from saflite.console.view import out
    from saflite.runtime import run_modules

    campaign_options.at_least("-n", args.n, 1)
    if args.case.is_dir():
        run_modules.use(args.case, args.module)
    build = builds.parse(args.target) if args.target else None
    one = known.one_of(args.case, args.violation, tuple(args.policy), anywhere=args.anywhere)
    flown = flaking.flake(one, build or builds.of_case(one.test_case), args.n, args.wall_limit)
    if args.json:
        out.json(flaking.plain(flown))
    else:
        for text in flaking.lines(flown):
            out.line(text)
    return flaking.exit_code(flown)
