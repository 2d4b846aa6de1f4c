"""Fly known violations on another build: fixed, still there, changed, flaky.

Takes a run folder (its confirmed violations, one of each behaviour) or a corpus, a folder that `--corpus` wrote: what
is fixed stays in it, so that a nightly `saflite regress CORPUS` sees it come back. Each is flown three times (five
where flights repeat only statistically), first under the noise of its record, then under noise that no campaign flies;
the interval of its rate is of the latter.

A build is `TARGET[+DEFECT...] [SETTING=VALUE ...]`, TARGET a name or a module file (.py). With no `--target` each flies
on its own target as it is installed now. Exit code 0: all fixed; 1: something is violated; 3: something could not be
flown or judged.

examples:
  saflite regress runs/policy-a-chute --target reference
  saflite regress runs/night --target new/firmware.py --corpus known/ --junit junit.xml
  saflite regress known/ --known-ok --sarif regress.sarif
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments, ci_options

    parser.add_argument("run", type=Path, help="run folder or corpus")
    parser.add_argument("--target", default="", metavar="BUILD", help="fly on this build")
    arguments.add_target_settings(parser)
    parser.add_argument("--violation", default="", metavar="ID", help="only this fingerprint or test case (its start)")
    parser.add_argument("--all", action="store_true", help="of a run, flaky and unconfirmed violations too")
    parser.add_argument("--times", type=int, metavar="N", help="flights of each (3; 5 where they differ by nature)")
    parser.add_argument("--known-ok", action="store_true", help="exit 1 only for what changed or came back")
    parser.add_argument("--corpus", type=Path, metavar="FOLDER", help="keep them, and what became of them, there")
    arguments.add_wall_limit(parser)
    arguments.add_modules(parser)
    ci_options.add_options(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object per violation")


def run(args: argparse.Namespace) -> int:
    """Fly each again and say what became of it."""
    from saflite.console.io import campaign_options, ci_options, outputs
    from saflite.console.operations import builds, regressing
    from saflite.console.run_data import known
    from saflite.console.view import ci_files, out, regression
    from saflite.contract.errors import Refused
    from saflite.runtime import run_modules

    if args.times is not None:
        campaign_options.at_least("--times", args.times, 1)
    if args.target and (args.target_set or args.defect):
        raise Refused("--target", expected="settings and defects in the build itself", got="--target-set or --defect")
    ci_options.check_options(args)
    if args.corpus is not None:
        outputs.check_takes(args.corpus, "--corpus")
    run_modules.use(args.run, args.module)
    build = builds.parse(args.target) if args.target else None
    found = known.read(args.run, args.violation, everything=args.all)
    if args.corpus is not None:
        found = known.with_standing(found, args.corpus)
    results = []
    for result in regressing.regress(
        found,
        build,
        times=args.times,
        wall_limit_s=args.wall_limit,
        settings=args.target_set,
        defects=args.defect,
    ):
        results.append(result)
        out.json(regression.plain(result)) if args.json else out.line(regression.line(result))
        out.flush()
        if args.corpus is not None:
            known.keep([regressing.after(result)], args.corpus)
    if not args.json:
        out.line(regression.summary(results))
    ci_files.write(args, f"regress {args.run.name}", [regressing.check(one, known_ok=args.known_ok) for one in results])
    return regressing.exit_code(results, known_ok=args.known_ok)
