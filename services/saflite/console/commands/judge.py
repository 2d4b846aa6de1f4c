"""Judge recordings or logs of flights by policies: one file or a folder of them.

Takes recordings (.mcap), stored traces (.trace), PX4 logs (.ulg), extracts of those (.csv) and ArduCopter logs (.bin).
Settings, failsafes and orders are read from the log. Recordings carry their test case; the others need `--test-case`
where a policy looks at obstacles. Without `--policy` a log is judged by the policies that fit its autopilot.

exit codes: 0 held, 1 a policy was violated, 2 a file was refused, 4 nothing could be judged (no rule applied).

examples:
  saflite judge flight.mcap
  saflite judge log.ulg --test-case case.yaml
  saflite judge log.bin --policy a-rtl1 --policy a-chute --json
  saflite judge logs/ --quiet --csv verdicts.csv --html verdicts.html
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from saflite.console.operations.log_judging import Judged


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments, outputs

    parser.add_argument("file", type=Path, help="recording or log (.mcap, .trace, .ulg, .csv, .bin), or a folder")
    parser.add_argument("--test-case", type=Path, help="what was flown: .yaml, .json, .mcap or .plan")
    arguments.add_policy(parser, "policy to judge by, all that fit if none is given")
    parser.add_argument("--all", action="store_true", help="show policies that say nothing of this flight, and why")
    parser.add_argument("--quiet", "-q", action="store_true", help="print violations and a last line only, for CI")
    parser.add_argument("--json", action="store_true", help="print the judgement as JSON; of a folder a list")
    parser.add_argument("--csv", type=Path, help="write every verdict to this file")
    parser.add_argument("--html", type=Path, help="write a page with every verdict to this file")
    outputs.add_force(parser)


def run(args: argparse.Namespace) -> int:
    """Judge and print; see `exit codes`."""
    from saflite.console.io import outputs
    from saflite.console.operations import log_judging
    from saflite.console.view import out

    for option, path in (("--csv", args.csv), ("--html", args.html)):
        if path is not None:
            outputs.check_file(path, force=args.force, option=option)
    policies = tuple(args.policy)
    whole = args.file.is_dir()
    if whole:
        judged = list(log_judging.judge_folder(args.file, args.test_case, policies))
    else:
        judged = [log_judging.judge_file(args.file, args.test_case, policies)]
    for one in judged:
        if one.lost:
            out.complain("damaged", f"{one.path}: {'; '.join(one.lost)}")
    if args.csv is not None:
        outputs.write(args.csv, log_judging.as_csv(judged), force=args.force, option="--csv")
    if args.html is not None:
        outputs.write(args.html, log_judging.as_html(judged), force=args.force, option="--html")
    if args.json:
        out.json(log_judging.as_json(judged) if whole else judged[0].judgement)
    elif args.quiet:
        _quiet(judged)
    else:
        _show(judged, whole, args.all)
    return log_judging.exit_code(judged)


def _show(judged: Sequence[Judged], whole: bool, everything: bool) -> None:
    from saflite.console.operations import judging, log_judging
    from saflite.console.view import out

    if whole:
        out.table(log_judging.rows(judged), headers=log_judging.headers())
    for one in judged:
        if one.case is None or one.flight is None or one.judgement is None:
            continue
        if not whole or everything:
            judging.show(one.case, one.flight, one.judgement, everything)
            lacked = log_judging.missing(one.verdicts)
            if lacked:
                out.line(f"  missing in the log, and how many policies lack it: {lacked}")
    _say_nothing_judged(judged)


def _quiet(judged: Sequence[Judged]) -> None:
    from collections import Counter

    from saflite.console.view import out

    for one in judged:
        for verdict in one.verdicts:
            if verdict.outcome == "violated":
                out.line(f"{one.path}: {verdict.policy} {verdict.robustness:+.3g}  {verdict.message}")
        if one.refused:
            out.line(f"{one.path}: refused: {one.refused}")
    _say_nothing_judged(judged)
    count = Counter(one.result for one in judged)
    out.line(", ".join(f"{number} {result}" for result, number in sorted(count.items())))


def _say_nothing_judged(judged: Sequence[Judged]) -> None:
    from saflite.console.operations import log_judging
    from saflite.console.view import out

    for one in judged:
        if one.result == "nothing judged":
            why = log_judging.why_nothing(one.verdicts)
            out.complain("NOTHING JUDGED", f"{one.path}: of {len(one.verdicts)} policies none was. {why}")
