"""Run a campaign on this machine: find violations, prove each by flying it again, leave recordings and a report.

The campaign is a built-in one (`saflite list campaigns`) or a TOML file. Ctrl-C stops clean; `saflite resume` goes on.
Exit code 0: nothing was found; 1: violations, confirmed ones or (as where it was stopped before they were flown again)
such that are neither confirmed nor refuted; 2: refused input; 3: infrastructure, or the campaign broke before its
budget was flown, as where its strategy fails (and no violation was found); 4: nothing was judged. A strategy that has
nothing new to propose ends its campaign without an error. Why it ended stands in the last lines.

examples:
  saflite run avoidance-m2
  saflite run avoidance-m3 --budget 300 --rng-seed 7 --workers 4 --out runs/night
  saflite run policy-a-chute --target reference --defect parachute-in-acro
  saflite run avoidance-m2 --minutes 10 --stop-at-first
  saflite run my-campaign.toml --strategy deephyperion --scorer ollama:mistral
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console.io import farm_options
from saflite.contract.plain import argument

if TYPE_CHECKING:
    from saflite.contract.config import Campaign
    from saflite.contract.control import Status
    from saflite.runtime.campaign_runner import ExitSummary


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("campaign", help="built-in campaign or .toml file")
    parser.add_argument("--target", default="", help="on this target (see `saflite list targets`)")
    parser.add_argument("--out", type=Path, metavar="RUN", help="run folder, must not exist (runs/CAMPAIGN)")
    parser.add_argument(
        "--budget", type=int, metavar="N", help="first flights, one a test case; re-flights and minimising come on top"
    )
    arguments.add_minutes(parser)
    parser.add_argument("--stop-at-first", action="store_true", help="stop at the first confirmed violation")
    parser.add_argument("--workers", type=int, metavar="N", help="simulator workers (one per core)")
    parser.add_argument("--rng-seed", type=arguments.rng_seed, metavar="N", help="start of every random draw")
    parser.add_argument("--strategy", default="", help="see `saflite list strategies`")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="setting of the strategy")
    parser.add_argument("--corpus", type=Path, metavar="RUN", help="begin with what an earlier run of it kept")
    parser.add_argument("--scorer", default="", help="see `saflite list scorers`; e.g. ollama:mistral")
    parser.add_argument("--shadow", action="append", default=[], metavar="MODEL", help="score with it too, undecided")
    arguments.add_target_settings(parser)
    arguments.add_modules(parser)
    farm_options.listening(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else")


def _on_top(campaign: Campaign) -> str:
    """Return in words what is flown beside the budget."""
    search = campaign.search
    minimising = ", then its minimising" if search.shrink else ""
    return (
        f"{search.confirm_flights or 'a few'} re-flights for each new behaviour{minimising}; "
        f"{search.check_share:.0%} flown twice to check the farm"
    )


def run(args: argparse.Namespace) -> int:
    """Run the campaign to its end; 1 if violations were found that are confirmed, or not refuted yet."""
    from saflite.console.io import campaign_options, named_autopilot
    from saflite.console.operations import running
    from saflite.console.run_data import corpus
    from saflite.console.view import out
    from saflite.runtime import campaign_runner
    from saflite.simulator_worker.registry import describe_target

    farm_options.check(args)
    after_s = campaign_options.seconds_of(args.minutes)
    campaign = campaign_options.changed(
        campaign_options.load(args.campaign, args.target),
        rng_seed=args.rng_seed,
        budget=args.budget,
        strategy=args.strategy,
        settings=args.set,
        scorer=args.scorer,
        shadow=args.shadow,
        target_settings=args.target_set,
        defects=args.defect,
    )
    if args.corpus is not None:
        campaign = corpus.with_corpus(campaign, args.corpus, describe_target(campaign.target.name))
    campaign_options.check_runnable(campaign)
    named_autopilot.check_flies(args.autopilot, campaign.target.name)
    run_dir = args.out or running.free_folder(campaign.name)
    running.check_new(run_dir)
    if not args.json:
        scorer = f"scorer {campaign.scorer.model}, strategy {campaign.strategy.name}"
        out.line(f"campaign {campaign.name}: {campaign.budget_flights} flights, {scorer}, rng_seed {campaign.rng_seed}")
        out.line(f"on top of the flights: {_on_top(campaign)}")
        out.line(f"run folder {run_dir}")
        if args.listen:
            how = " --keys FOLDER" if args.keys else " --insecure" if args.insecure else ""
            out.line(f"others join with `saflite worker --join {argument(args.listen)}{how}`")
        for remark in campaign_options.remarks(campaign):
            out.line(remark)
        out.flush()

    def start(on_status: Callable[[Status], None]) -> ExitSummary:
        return campaign_runner.resume(
            run_dir,
            simulators=args.workers,
            on_status=on_status,
            listen=args.listen,
            keys=args.keys,
            on=args.on,
            scale=farm_options.scale(args),
            insecure=args.insecure,
            json_logs=args.json_logs,
            stop_when=campaign_runner.StopWhen(after_s, args.stop_at_first),
        )

    running.create(run_dir, campaign, describe_target(campaign.target.name))
    return running.follow(run_dir, start, as_json=args.json, metrics=args.metrics)
