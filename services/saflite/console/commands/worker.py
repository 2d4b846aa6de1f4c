"""Join a running farm, maybe one on another machine, and work for it until its campaign is over.

The farm must listen where this machine reaches it: `saflite run CAMPAIGN --listen ENDPOINT`. The run folder is not
needed here. Who joins must run the same version; the farm refuses others in words. Ctrl-C hands back what is held.

examples:
  saflite worker --join runs/night
  saflite worker --join tls/10.0.0.5:7447 --keys lab2 --stages fly --workers 8
  saflite worker --join tcp/10.0.0.5:7447 --insecure --stages fly,judge --workers 8 --name lab2
  saflite worker --join unixsock-stream//run/farm.sock --state ~/.saflite/worker --module my_target.py

Exit codes: 0 the campaign is over or stopped by Ctrl-C, 2 refused, 3 nobody answers or the workers cannot run.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saflite.contract.work import Stage


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments, farm_options

    parser.add_argument(
        "--join", required=True, metavar="ENDPOINT|RUN", help="where the farm listens, or its run folder"
    )
    parser.add_argument("--stages", default="fly", help="any of mutate,score,fly,judge,record (fly)")
    parser.add_argument("--campaign", default="", help="its campaign (asked for if only one runs there)")
    parser.add_argument("--workers", type=int, metavar="N", help="workers of each stage (fly: one per core, others: 1)")
    parser.add_argument("--name", default="", help="begins the workers' names (host and folder)")
    parser.add_argument("--state", type=Path, metavar="DIR", help="folder for logs and undelivered results (temporary)")
    arguments.add_modules(parser)
    parser.add_argument("--label", action="append", default=[], metavar="NAME=VALUE", help="shown in the farm's status")
    arguments.add_patience(parser, "end after so long unanswered")
    parser.add_argument("--keys", type=Path, metavar="FOLDER", help=farm_options.KEYS)
    parser.add_argument("--insecure", action="store_true", help=farm_options.INSECURE)
    farm_options.telling(parser)


def run(args: argparse.Namespace) -> int:
    """Work until the campaign is over."""
    from saflite.console.view import out
    from saflite.runtime import worker_group
    from saflite.runtime.client import read_info

    workers = _workers(args.stages, args.workers)
    _check_name(args.name, workers)
    farm = read_info(Path(args.join)) if Path(args.join).is_dir() else None
    if farm is None:
        _check_endpoint(args.join)
    group = worker_group.Group(
        endpoint=farm.endpoint if farm else args.join,
        workers=workers,
        campaign=args.campaign or (farm.campaign if farm else ""),
        name=args.name,
        folder=args.state,
        modules=tuple(args.module),
        labels=_labels(args.label),
        keys=args.keys,
        insecure=args.insecure or (farm is not None and farm.insecure),
        patience_s=args.patience,
        metrics=args.metrics,
        json_logs=args.json_logs,
    )

    def say(text: str) -> None:
        out.line(text)
        out.flush()

    end = worker_group.run(group, say)
    if end.condition == "finished":
        say(end.message)
        return 0
    word = "refused" if end.condition == "refused" else "unavailable"
    out.complain(word, end.message)
    return 2 if word == "refused" else 3


def _check_endpoint(join: str) -> None:
    """Raise Refused for what is neither an endpoint nor a run folder that is there."""
    from saflite.bus.endpoints import EXPECTED, parse_endpoint
    from saflite.contract.errors import Refused
    from saflite.contract.plain import cut

    try:
        parse_endpoint(join, "--join")
    except Refused as fault:
        if fault.expected != EXPECTED:
            raise
        expected = f"{EXPECTED}, or a run folder that is there"
        raise Refused("--join", expected=expected, got=f"{cut(join, 120)!r}, where there is no folder") from fault


def _check_name(name: str, workers: dict[Stage, int]) -> None:
    from saflite.contract.errors import Refused
    from saflite.contract.names import NAME_CHARS_MAX, NAME_EXPECTED, is_name
    from saflite.contract.plain import cut

    if name and not is_name(name):
        raise Refused("--name", expected=f"what a worker name begins with: {NAME_EXPECTED}", got=repr(cut(name, 80)))
    room = NAME_CHARS_MAX - max(len(f"-{stage}-{count}") for stage, count in workers.items())
    if len(name) > room:
        expected = f"at most {room} characters: stage and number follow it in the workers' names"
        raise Refused("--name", expected=expected, got=f"{len(name)} in {name!r}")


def _workers(text: str, count: int | None) -> dict[Stage, int]:
    from saflite.console.io import campaign_options
    from saflite.contract.errors import Refused
    from saflite.contract.topics import STAGES
    from saflite.runtime.farm import default_simulators

    if count is not None:
        campaign_options.at_least("--workers", count, 1, campaign_options.WORKERS_MAX)
    wanted = text.split(",")
    unknown = [word for word in wanted if word not in STAGES]
    if unknown or len(set(wanted)) != len(wanted):
        raise Refused("--stages", expected=f"some of {','.join(STAGES)}, each once", got=repr(text))
    return {stage: count or (default_simulators() if stage == "fly" else 1) for stage in STAGES if stage in wanted}


def _labels(texts: list[str]) -> dict[str, str]:
    from saflite.contract.errors import Refused

    pairs = [text.partition("=") for text in texts]
    for text, (name, equals, _) in zip(texts, pairs, strict=True):
        if not name or not equals:
            raise Refused("--label", expected="NAME=VALUE", got=repr(text))
    return {name: value for name, _, value in pairs}
