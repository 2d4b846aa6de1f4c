"""Fly one test case and judge the flight.

The test case is competition YAML, our JSON, a recording, or a mission plan of QGroundControl. The flight runs in a
sandbox of its own, as in the farm.
Without `--policy` it is judged by all policies that ship, and by the rules of your own that its recording or run has.

exit codes: 0 held, 1 a policy was violated, 2 refused input, 3 it could not be flown, 4 nothing could be judged (no
rule applied).

examples:
  saflite fly case.yaml
  saflite fly case.yaml --out flight.mcap --policy min-obstacle-distance
  saflite fly case.json --defect parachute-in-acro --json
  saflite fly case.json --twin turned --policy turned-alike
  saflite fly mission.plan --target ardupilot --autopilot build/sitl/bin/arducopter --artefacts logs
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console.io import outputs

if TYPE_CHECKING:
    from saflite.console.operations.judging import Flown
    from saflite.contract.test_case import TestCase
    from saflite.contract.verdict import Judgement
    from saflite.contract.work import PolicyTexts


TWINS = (
    "turned",
    "idle",
    "afresh",
    "mirrored",
    "recalibrated",
)  # `contract.test_case.Twin`, which a page of help must not load


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("case", type=Path, help="test case: .yaml, .json, .mcap or .plan")
    parser.add_argument("--target", default="", help="fly on this target instead (see `saflite list targets`)")
    arguments.add_policy(parser, "policy to judge by")
    arguments.add_target_settings(parser)
    parser.add_argument("--parameter", action="append", default=[], metavar="NAME=NUMBER", help="set before take-off")
    parser.add_argument("--rng-seed", type=arguments.rng_seed, help="random seed of noise and gusts")
    parser.add_argument("--twin", choices=TWINS, default="", help="fly a second flight to compare with")
    arguments.add_wall_limit(parser)
    arguments.add_modules(parser)
    parser.add_argument("--out", type=Path, help="write a recording (.mcap)")
    parser.add_argument("--artefacts", type=Path, metavar="DIR", help="write what the autopilot left (its logs) there")
    outputs.add_force(parser)
    arguments.add_anywhere(parser)
    parser.add_argument("--all", action="store_true", help="show policies that have nothing to say of this flight, too")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Fly, judge, print; see `exit codes`."""
    from saflite.campaign.presets.campaigns import with_texts
    from saflite.console.cli import NOTHING_JUDGED
    from saflite.console.io import cases
    from saflite.console.operations import judging
    from saflite.console.run_data import known
    from saflite.console.view import out
    from saflite.contract.errors import Unavailable
    from saflite.contract.flight import FLOWN_ENDINGS
    from saflite.oracle.policy import policy_names

    _check_places(args)
    case = cases.with_changes(
        cases.load_case(args.case),
        target=args.target,
        settings=args.target_set,
        defects=args.defect,
        parameters=args.parameter,
        rng_seed=args.rng_seed,
        twin=args.twin,
    )
    cases.check_layout(case, str(args.case), args.anywhere)
    flown = judging.fly(case, args.wall_limit)
    if args.artefacts is not None:  # first of all: who cannot judge a flight wants them the more
        for name, data in flown.files:
            outputs.write(args.artefacts / name, data, force=args.force)
    if flown.flight.ending not in FLOWN_ENDINGS:
        raise Unavailable(f"the flight ended as {flown.flight.ending}: {flown.flight.message}")
    policies, texts = with_texts(args.policy, Path())
    own = known.policies_with(args.case)
    chosen = policies or (*policy_names(), *own)
    texts = {name: text for name, text in {**own, **texts}.items() if name in chosen}
    judgement = judging.judge(case, flown, chosen, texts)
    alone, found = judging.why_alone(case, flown), judging.apart(flown)
    if alone:
        out.complain("warning", f"twin {case.twin}: {alone}")
    if args.out is not None:
        outputs.write(args.out, _recording(case, flown, judgement, texts), force=args.force)
    if args.json:
        beside = None if found is None else found.apart_m
        twin = {"asked": case.twin, "compared": not alone, "why": alone, "apart_m": beside} if case.twin else None
        out.json({"flight": flown.flight, "judgement": judgement, "twin": twin, "recording": str(args.out or "")})
    else:
        judging.show(case, flown.flight, judgement, args.all)
        if found is not None:
            out.line(f"twin       {judging.twin_in_words(case, judgement, found, texts)}")
        if args.out is not None:
            out.line(f"recording  {args.out}")
        if args.artefacts is not None:
            left = ", ".join(name for name, _ in flown.files) or f"none: {case.target.name} left no files"
            out.line(f"artefacts  {args.artefacts}: {left}")
    code = judging.exit_code(judgement)
    if code == NOTHING_JUDGED:
        from saflite.console.operations import log_judging

        why = log_judging.why_nothing(judgement.verdicts)
        out.complain("NOTHING JUDGED", f"of {len(judgement.verdicts)} policies none was. {why}")
    return code


def _check_places(args: argparse.Namespace) -> None:
    """Raise Refused before anything is flown where something stands already that is not to be written over."""
    if args.out is not None:
        outputs.check_file(args.out, force=args.force)
    if args.artefacts is not None:
        outputs.check_folder(args.artefacts, force=args.force, option="--artefacts")


def _recording(case: TestCase, flown: Flown, judgement: Judgement, texts: PolicyTexts) -> bytes:
    from saflite.contract.work import RecordWork
    from saflite.recorder import mcap
    from saflite.runtime.clock import WallClock

    work = RecordWork(test_case=case, flight=flown.flight, judgement=judgement, policy_texts=texts)
    return mcap.write(work, flown.packed, WallClock().unix_s() - flown.flight.wall_s)
