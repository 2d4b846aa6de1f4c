"""Fly what a run flew on another build, and tell where it flies otherwise: with or without a rule that is broken.

Takes first flights of a run, by lot, held and violated alike, and flies each on the build under the same noise. A test
case is `equal` (bit by bit), `alike` (same ending, states and verdicts, no farther apart than --near), `varies` (not
alike, but the build's own flights under other noise differ as much) or `differs`. No rule is needed that says what the
right flight would be, so it is no violation: a change that was meant shows as well.

A build is as for `saflite regress`. Exit code 0: none differs; 1: one does; 3: one could not be flown.

examples:
  saflite compare runs/night --autopilot new/arducopter
  saflite compare runs/policy-a-chute --target "reference+parachute-in-acro" --count 50
  saflite compare runs/night --target new/firmware.py --all --junit junit.xml
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments, ci_options

    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("--target", default="", metavar="BUILD", help="fly on this build")
    arguments.add_target_settings(parser)
    parser.add_argument("--count", type=int, default=30, metavar="N", help="test cases drawn by lot (30)")
    parser.add_argument("--all", action="store_true", help="all test cases of the run")
    parser.add_argument("--times", type=int, default=4, metavar="N", help="flights of each that is not alike (4)")
    parser.add_argument("--near", type=float, default=2.0, metavar="M", help="so many metres apart is alike (2)")
    parser.add_argument("--rng-seed", type=arguments.rng_seed, default=1, metavar="N", help="of the lot")
    arguments.add_wall_limit(parser)
    arguments.add_modules(parser)
    ci_options.add_options(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object per test case")


def run(args: argparse.Namespace) -> int:
    """Fly, compare, tell."""
    from saflite.console.io import campaign_options, ci_options
    from saflite.console.operations import back_to_back, builds
    from saflite.console.run_data.run_folder import open_run
    from saflite.console.view import ci_files, out
    from saflite.contract.errors import Refused
    from saflite.runtime import run_modules

    campaign_options.at_least("--count", args.count, 1)
    campaign_options.at_least("--times", args.times, 2)
    if not 0.0 <= args.near < float("inf"):
        raise Refused("--near", expected="metres, 0 or more", got=args.near)
    if args.target and (args.target_set or args.defect):
        raise Refused("--target", expected="settings and defects in the build itself", got="--target-set or --defect")
    ci_options.check_options(args)
    run_modules.use(args.run, args.module)
    build = builds.parse(args.target) if args.target else None
    with open_run(args.run) as found:
        before = back_to_back.flown_before(found, None if args.all else args.count, args.rng_seed)
        of, policies, texts = found.flown()["search"], found.campaign.policies, found.campaign.policy_texts
        template = found.template
    build = build or builds.of_case(template, args.target_set, args.defect)
    builds.use(build)
    results = []
    for result in back_to_back.compare(
        before, build, policies, texts, times=args.times, near_m=args.near, wall_limit_s=args.wall_limit
    ):
        results.append(result)
        out.json(back_to_back.plain(result)) if args.json else out.line(back_to_back.line(result))
        out.flush()
    if not args.json:
        out.line(back_to_back.summary(results, of, args.times))
    ci_files.write(args, f"compare {args.run.name}", [back_to_back.check(one) for one in results])
    return back_to_back.exit_code(results)
