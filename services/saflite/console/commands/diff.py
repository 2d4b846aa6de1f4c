"""Search two builds alike and report only what is new in the second.

Both are searched with one campaign and random seed. What only the search of the second showed is flown again on both,
under noise that no search flew: reported as new is what violates more often on the second with the confidence asked for
(flat priors on both rates). A build is as for `saflite regress`. Exit code 0: nothing new; 1: something new; 3: it
cannot be said.

examples:
  saflite diff betaflight_stock betaflight --campaign betaflight-failsafe --budget 200
  saflite diff reference reference+parachute-in-acro --campaign policy-a-chute --budget 60
  saflite diff old/firmware.py new/firmware.py --campaign my.toml --out runs/pr-17 --junit junit.xml
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments, ci_options

    parser.add_argument("old", metavar="BUILD_A", help="the build that is known")
    parser.add_argument("new", metavar="BUILD_B", help="the build in question")
    parser.add_argument("--campaign", required=True, metavar="NAME", help="built-in campaign or .toml file")
    parser.add_argument("--budget", type=int, metavar="N", help="first flights of each search")
    parser.add_argument("--rng-seed", type=arguments.rng_seed, metavar="N", help="start of every random draw of both")
    parser.add_argument("--workers", type=int, metavar="N", help="simulator workers (one per core)")
    parser.add_argument("--times", type=int, default=5, metavar="N", help="flights of each find on each build (5)")
    parser.add_argument("--confidence", type=float, default=0.95, metavar="P", help="asked of what is new (0.95)")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FOLDER",
        help="for both runs (runs/diff-CAMPAIGN); goes on with what was stopped there",
    )
    arguments.add_wall_limit(parser)
    arguments.add_modules(parser)
    ci_options.add_options(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else")


def run(args: argparse.Namespace) -> int:
    """Search both, fly again, tell."""
    from saflite.console.io import campaign_options, ci_options
    from saflite.console.operations import builds, comparing, running
    from saflite.console.view import ci_files, out
    from saflite.contract.errors import Refused

    campaign_options.at_least("--times", args.times, 1)
    if args.workers is not None:
        campaign_options.at_least("--workers", args.workers, 1)
    if not 0.5 <= args.confidence < 1.0:
        raise Refused("--confidence", expected="0.5 to below 1", got=args.confidence)
    ci_options.check_options(args)
    new, old = builds.parse(args.new), builds.parse(args.old)
    campaign = campaign_options.changed(
        campaign_options.load(args.campaign, old.target.name), rng_seed=args.rng_seed, budget=args.budget
    )
    for build in (new, old):
        builds.use(build)
        campaign_options.check_runnable(comparing.on_build(campaign, build))
    folder = args.out or running.free_folder(f"diff-{campaign.name}")
    comparing.check_folder(folder)
    found = comparing.compare(
        campaign,
        old,
        new,
        folder,
        times=args.times,
        workers=args.workers,
        wall_limit_s=args.wall_limit,
        quiet=args.json,
    )
    if args.json:
        out.json({**comparing.plain(found, args.confidence), "runs": str(folder)})
    else:
        for text in comparing.lines(found, old, new, args.confidence):
            out.line(text)
        out.line(f"runs        {folder}")
    ci_files.write(
        args, f"diff {args.old} {args.new}", [comparing.check(one, args.confidence) for one in found.compared]
    )
    return comparing.exit_code(found, args.confidence)
