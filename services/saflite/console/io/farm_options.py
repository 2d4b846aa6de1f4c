"""Arguments about where a farm listens and is reached, as several commands share them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console.run_data.farm_lookup import Where
from saflite.contract.errors import Refused

if TYPE_CHECKING:
    from saflite.contract.work import Stage
    from saflite.runtime.autoscaling import Bounds

KEYS = "folder of a key, for an endpoint tls/HOST:PORT (`saflite keys add` makes one)"
INSECURE = "allow an endpoint that others can reach (TCP): nothing is encrypted or authenticated"


def listening(parser: argparse.ArgumentParser) -> None:
    """Name the arguments of a command that starts a farm."""
    parser.add_argument("--listen", default="", metavar="ENDPOINT", help="where others may join (a private socket)")
    where = "where the workers run: here (default), ray, ray:ADDRESS (books stay here)"
    parser.add_argument("--on", default="here", metavar="PLACE", help=where)
    bounds = "workers of a stage, as many as its queue asks for, such as fly=2:16 (may be repeated)"
    parser.add_argument("--scale", action="append", default=[], metavar="STAGE=MIN:MAX", help=bounds)
    keys = "folder of the farm's keys, for --listen tls/HOST:PORT (see `saflite keys`)"
    parser.add_argument("--keys", type=Path, metavar="FOLDER", help=keys)
    parser.add_argument("--insecure", action="store_true", help=INSECURE)
    telling(parser)


def telling(parser: argparse.ArgumentParser) -> None:
    """Name the arguments about what machines are told: metrics and logs."""
    where = "tell metrics at http://HOST:PORT/metrics (HOST: loopback if left out)"
    parser.add_argument("--metrics", default="", metavar="[HOST:]PORT", help=where)
    parser.add_argument("--json-logs", action="store_true", help="write logs as one JSON object a line")


def connecting(parser: argparse.ArgumentParser) -> None:
    """Name the arguments of a command that talks to a running farm, maybe one on another machine."""
    parser.add_argument("--connect", default="", metavar="ENDPOINT", help="farm without a run folder here")
    parser.add_argument("--campaign", default="", help="its campaign, with --connect (the one that runs there)")
    parser.add_argument("--keys", type=Path, metavar="FOLDER", help=KEYS)
    parser.add_argument("--insecure", action="store_true", help=INSECURE)


def where(args: argparse.Namespace) -> Where:
    """Return the farm the arguments of `connecting` and RUN name."""
    return Where(args.run, args.connect, args.campaign, args.insecure, args.keys)


def scale(args: argparse.Namespace) -> dict[Stage, Bounds]:
    """Return what --scale says, by stage."""
    from saflite.runtime.autoscaling import parse_bounds

    return parse_bounds(args.scale)


def check(args: argparse.Namespace) -> None:
    """Raise Refused for what makes no sense or finds no room on this machine, before anything is made."""
    from saflite.bus.endpoints import check_endpoint
    from saflite.console.io import campaign_options
    from saflite.runtime.farm import default_simulators, roles
    from saflite.runtime.process_limits import prepare_limits

    if args.workers == 0 and not args.listen:
        raise Refused("--workers", expected="1 or more, or --listen beside it for those who join", got=0)
    if args.workers is not None:
        campaign_options.at_least("--workers", args.workers, 0, campaign_options.WORKERS_MAX)
    prepare_limits(len(roles(default_simulators() if args.workers is None else args.workers)))
    if "fly" in scale(args) and args.workers is not None:
        raise Refused("--workers", expected="none beside --scale fly=...", got=args.workers)
    if args.metrics:
        from saflite.runtime.metrics import check_address

        check_address(args.metrics)
    if args.listen:
        check_endpoint(args.listen, insecure=args.insecure, keys=args.keys is not None, argument="--listen")
    if args.on != "here":
        from saflite.runtime.on_ray import check_place

        check_place(args.on, listen=args.listen)
    if args.keys is not None:
        from saflite.bus.keyring import farm_credentials, warnings
        from saflite.console.view import out
        from saflite.runtime.clock import WallClock

        if not args.listen:
            raise Refused("--keys", expected="--listen tls/HOST:PORT with it", got="none")
        now_s = WallClock().unix_s()
        farm_credentials(args.keys, now_s)
        for warning in warnings(args.keys, now_s):
            out.complain("warning", warning)
