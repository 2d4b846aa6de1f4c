"""Let a strategy propose test cases, as the farm's mutator does, and write them as files.

examples:
  saflite mutate avoidance-m2 --count 5
  saflite mutate avoidance-m3 --strategy deephyperion --count 20 --rng-seed 7 --out cases/
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console.io import outputs

if TYPE_CHECKING:
    from saflite.contract.work import MutateResult, MutateWork

COUNT_MAX = 10_000  # what one round of a campaign may have


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("campaign", help="built-in campaign or campaign file, for mission and policies")
    parser.add_argument("--target", default="", help="for this target (see `saflite list targets`)")
    parser.add_argument("--strategy", default="", help="strategy instead of the campaign's")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="setting of the strategy")
    arguments.add_modules(parser)
    parser.add_argument("--count", "-n", type=int, default=5, help="how many test cases (5)")
    parser.add_argument("--round", type=int, default=0, help="round to draw for (0)")
    parser.add_argument("--rng-seed", type=arguments.rng_seed, help="random seed instead of the campaign's")
    parser.add_argument(
        "--out", type=Path, help="folder for one .json per test case, and .yaml where it can be said so"
    )
    outputs.add_force(parser)
    parser.add_argument("--json", action="store_true", help="print the test cases as JSON, one per line")


def run(args: argparse.Namespace) -> int:
    """Ask the strategy once and print what it proposes."""
    from saflite.campaign.presets.campaigns import template
    from saflite.campaign.scheduling.proposal_check import unfit
    from saflite.console.io import campaign_options, case_files
    from saflite.console.view import out
    from saflite.contract.errors import Refused
    from saflite.contract.test_case import identity
    from saflite.contract.work import MutateWork
    from saflite.simulator_worker.registry import describe_target

    campaign = campaign_options.changed(
        campaign_options.load(args.campaign, args.target),
        rng_seed=args.rng_seed,
        strategy=args.strategy,
        settings=args.set,
    )
    campaign_options.at_least("--count", args.count, 1)
    campaign_options.at_least("--round", args.round, 0)
    if args.count > COUNT_MAX:
        raise Refused("--count", expected=f"at most {COUNT_MAX}, what one round of a campaign may have", got=args.count)
    if args.out is not None:
        outputs.check_folder(args.out, force=args.force)
    target = describe_target(campaign.target.name)
    if target.missing:  # nothing can be flown here: what its policies say is checked all the same
        campaign_options.check_policies(campaign.policies, campaign.policy_texts)
    else:
        campaign_options.check_runnable(campaign)
    work = MutateWork(
        round=args.round,
        count=args.count,
        strategy=campaign.strategy.name,
        settings=campaign.strategy.settings,
        rng_seed=campaign.rng_seed,
        template=template(campaign, target.build),
        target=target,
        policies=campaign.policies,
        outcomes=(),
        from_cursor=-1,
        cursor=-1,
    )
    result = _proposed(work)
    why = unfit(result.test_cases, work.template, args.count, campaign.scorer.batch)
    if why is not None:
        raise Refused(f"what strategy {work.strategy} proposes", expected=why.expected, got=why.got)
    for case in result.test_cases:
        if args.json:
            out.json(case)
        else:
            out.line(f"{identity(case)}  {case_files.one_line(case)}")
    if args.out is not None:
        case_files.write_cases(result.test_cases, args.out, force=args.force)
    return 0


def _proposed(work: MutateWork) -> MutateResult:
    from saflite.contract import wire
    from saflite.contract.errors import Refused, Unavailable
    from saflite.contract.work import MutateResult
    from saflite.mutator.work import open_service

    try:
        result = open_service().do(work, lambda: False)
    except Refused as fault:
        if work.target.missing:  # such a target does not tell what its inputs are
            raise Unavailable(work.target.missing) from fault
        raise
    assert isinstance(result, MutateResult)
    return wire.checked(result, MutateResult)  # as whoever reads them again will: in a farm, the books
