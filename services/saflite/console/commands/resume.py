"""Go on with a run that was stopped, killed, or ended: its budget counts on exactly where it was.

Exit codes are those of `saflite run`. A campaign that ended because its strategy failed tells so again; with a
`--budget`, the same one too, the strategy is asked again for the round that it failed at.

examples:
  saflite resume runs/avoidance-m2
  saflite resume runs/avoidance-m2 --budget 500
  saflite resume runs/avoidance-m2 --minutes 10
  saflite resume runs/avoidance-m2 --accept-loss
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING

from saflite.console.io import farm_options

if TYPE_CHECKING:
    from saflite.contract.control import Status
    from saflite.runtime.campaign_runner import ExitSummary


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    arguments.add_run(parser, "the newest at rest")
    parser.add_argument("--budget", type=int, metavar="N", help="new number of flights, those flown included")
    arguments.add_minutes(parser)
    parser.add_argument("--workers", type=int, metavar="N", help="simulator workers (one per core)")
    parser.add_argument(
        "--accept-loss", action="store_true", help="go on with what is left of damaged books, and say what is lost"
    )
    arguments.add_modules(parser)
    farm_options.listening(parser)
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else")


def run(args: argparse.Namespace) -> int:
    """Continue to the end; 1 if the run holds violations that are confirmed, or not refuted yet."""
    from saflite.console.io import campaign_options
    from saflite.console.operations import running
    from saflite.console.run_data import farm_lookup
    from saflite.console.run_data.run_folder import open_run
    from saflite.runtime import campaign_runner

    args.run = farm_lookup.newest_at_rest(args.run)
    farm_options.check(args)
    after_s = campaign_options.seconds_of(args.minutes)
    if args.budget is not None:
        campaign_options.at_least("--budget", args.budget, 1)
    open_run(args.run).close()
    running.check_books(args.run, accept_loss=args.accept_loss)

    def start(on_status: Callable[[Status], None]) -> ExitSummary:
        return campaign_runner.resume(
            args.run,
            simulators=args.workers,
            on_status=on_status,
            modules=args.module,
            budget=args.budget,
            listen=args.listen,
            keys=args.keys,
            on=args.on,
            scale=farm_options.scale(args),
            insecure=args.insecure,
            json_logs=args.json_logs,
            stop_when=campaign_runner.StopWhen(after_s),
        )

    return running.follow(args.run, start, as_json=args.json, metrics=args.metrics)
