"""Find the build, of several in order, that broke a test case or fixed it, with a probability.

CASE is as for `saflite flake`; a build is as for `saflite regress` (`TARGET[+DEFECT...] [SETTING=VALUE ...]`, TARGET a
name or a module file), the oldest first. Flights under other noise go where they tell most, until one answer is likely
enough; no campaign flies these noises. Flights and builds that fail on our side are counted apart. Exit code 0: fixed,
or never violated; 1: a build broke it, or all violate; 3: no answer is likely enough.

examples:
  saflite bisect case.json v1/firmware.py v2/firmware.py v3/firmware.py --policy upright
  saflite bisect runs/night --violation 3f2a betaflight_stock betaflight
  saflite bisect case.json reference "reference+parachute-in-acro" --policy a-chute --confidence 0.99
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("case", type=Path, help="test case, recording, file of a corpus, or run folder")
    parser.add_argument("builds", nargs="+", metavar="BUILD", help="builds in order, the oldest first")
    parser.add_argument("--violation", default="", metavar="ID", help="of a run: this fingerprint or test case")
    arguments.add_policy(parser, "the policy in question")
    parser.add_argument("--confidence", type=float, default=0.95, metavar="P", help="probability to end at (0.95)")
    parser.add_argument("--flights-max", type=int, default=200, metavar="N", help="give up after so many (200)")
    arguments.add_wall_limit(parser)
    arguments.add_anywhere(parser)
    arguments.add_modules(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Search, and tell."""
    from saflite.console.io import campaign_options
    from saflite.console.operations import bisecting, builds
    from saflite.console.run_data import known
    from saflite.console.view import out
    from saflite.contract.errors import Refused
    from saflite.runtime import run_modules

    if len(args.builds) < 2:
        raise Refused("builds", expected="two or more, the oldest first", got=str(len(args.builds)))
    if not 0.5 <= args.confidence < 1.0:
        raise Refused("--confidence", expected="0.5 to below 1", got=args.confidence)
    campaign_options.at_least("--flights-max", args.flights_max, 1)
    if args.case.is_dir():
        run_modules.use(args.case, args.module)
    one = known.one_of(args.case, args.violation, tuple(args.policy), anywhere=args.anywhere)
    row = [builds.parse_or_leave(text) for text in args.builds]
    found = bisecting.bisect(one, row, confidence=args.confidence, most=args.flights_max, wall_limit_s=args.wall_limit)
    if args.json:
        out.json(bisecting.plain(found, row))
    else:
        for text in bisecting.lines(found, row, one):
            out.line(text)
    return bisecting.exit_code(found)
