"""Run the farm a file describes: begin its campaign, or go on with it where the run folder holds one already.

A run folder goes on with the campaign it began with: another one in the file is refused, one whose budget or rules were
changed since is noted.

For machines that keep a farm running (`deploy/systemd`, `deploy/compose.yaml`): books and router run here, workers as
the file says, all others join. The same command after a crash or a restart of the machine goes on. A campaign that is
over is left as it is, with exit code 0, so that whatever starts failed commands again comes to rest.

  campaign = "night.toml"                # or a built-in one
  run = "runs/night"
  listen = "tls/0.0.0.0:7447"            # where others join; left out: this user only
  keys = "keys"
  metrics = "127.0.0.1:9464"
  [workers]                              # here; stages left out have none here
  mutate = 1
  judge = 1
  [scale]                                # as many as the queue asks for
  fly = { min = 0, max = 16 }

examples:
  saflite up farm.toml
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.contract.errors import FarmError, Refused
from saflite.contract.plain import argument

if TYPE_CHECKING:
    from saflite.console.io.farm_file import FarmFile
    from saflite.contract.control import Status
    from saflite.runtime.campaign_runner import ExitSummary


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("farm", type=Path, metavar="FARM.toml", help="the farm")
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else")


def run(args: argparse.Namespace) -> int:
    """Run the campaign to its end; 1 if confirmed violations were found, 0 if it had ended before."""
    from saflite.campaign.storage.store import store_file
    from saflite.console.io import farm_options
    from saflite.console.io.farm_file import read_farm_file
    from saflite.console.operations import running
    from saflite.console.view import out
    from saflite.contract.modules import use
    from saflite.runtime import campaign_runner

    farm = read_farm_file(args.farm)
    keys = Path(farm.keys) if farm.keys else None
    options = {"listen": farm.listen, "keys": keys, "insecure": farm.insecure, "metrics": farm.metrics}
    farm_options.check(argparse.Namespace(**options, workers=None, on="here", scale=[]))
    modules = [Path(module) for module in farm.modules]
    use(modules)
    run_dir = Path(farm.run)
    if store_file(run_dir).exists():
        running.check_books(run_dir, accept_loss=False)
        _check_campaign(farm, args.farm, run_dir)
        if running.is_concluded(run_dir):
            return _left_alone(run_dir, as_json=args.json)
    else:
        _create(farm, run_dir)
    if not args.json:
        scaled = {stage: f"{bounds.min} to {bounds.max}" for stage, bounds in farm.scale.items()}
        here = ", ".join(f"{count} {stage}" for stage, count in {**farm.workers, **scaled}.items() if count) or "none"
        out.line(
            f"farm {args.farm}: run folder {run_dir}, workers here: {here}, others join at {farm.listen or run_dir}"
        )
        out.flush()

    def start(on_status: Callable[[Status], None]) -> ExitSummary:
        return campaign_runner.resume(
            run_dir,
            cast=farm.workers,
            scale=farm.scale,
            on_status=on_status,
            modules=modules,
            listen=farm.listen,
            keys=keys,
            insecure=farm.insecure,
            json_logs=farm.json_logs,
        )

    return running.follow(run_dir, start, as_json=args.json, metrics=farm.metrics)


def _create(farm: FarmFile, run_dir: Path) -> None:
    from saflite.console.io import campaign_options
    from saflite.console.operations import running
    from saflite.simulator_worker.registry import describe_target

    campaign = campaign_options.load(farm.campaign)
    campaign_options.check_runnable(campaign)
    running.create(run_dir, campaign, describe_target(campaign.target.name))


def _check_campaign(farm: FarmFile, path: Path, run_dir: Path) -> None:
    """Raise Refused if the run folder holds another campaign than the file names; note another difference.

    One that cannot be read any more keeps no farm from going on.
    """
    from saflite.console.io import campaign_options
    from saflite.console.run_data.run_folder import open_run
    from saflite.console.view import out

    with open_run(run_dir) as run:
        began = run.campaign
    try:
        named = campaign_options.load(farm.campaign)
    except FarmError as fault:
        out.complain("note", f"{run_dir} goes on with campaign {began.name} as it began: {fault}")
        return
    if named.name != began.name:
        raise Refused(
            "run folder",
            where=str(run_dir),
            expected=f"a run of campaign {named.name}, which {path} names, or none",
            got=f"one of campaign {began.name}",
            fix=f"give each its own `run` in {path}",
        )
    if named != began:
        how = "was changed since, or other options began it"
        out.complain("note", f"{farm.campaign} is not what {run_dir} began with ({how}): the run goes on as it began")


def _left_alone(run_dir: Path, *, as_json: bool) -> int:
    from saflite.console.cli import NOTHING_FOUND
    from saflite.console.run_data.reporting import REPORT
    from saflite.console.run_data.run_folder import open_run
    from saflite.console.view import out

    with open_run(run_dir) as run:
        now, finds = run.standing(), run.standings()["confirmed"]
    if as_json:
        said = {"state": now.state, "why": now.why, "failed": now.failed, "confirmed": finds}
        out.json({"run": str(run_dir), "over": True, **said, "report": str(run_dir / REPORT)})
    else:
        fix = f"`{out.program()} resume {argument(run_dir)} --budget N` flies more"
        out.line(f"the campaign in {run_dir} is over ({now.why}), {finds} finds confirmed: {run_dir / REPORT}; {fix}")
    return NOTHING_FOUND
