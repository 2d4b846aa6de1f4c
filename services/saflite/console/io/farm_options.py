"""Arguments about where a farm listens and is reached, as several commands share them."""

from __future__ import annotations

import argparse

from saflite.console.run_data.farm_lookup import Where

INSECURE = "allow an endpoint that others can reach (TCP): nothing is encrypted or authenticated"


def listening(parser: argparse.ArgumentParser) -> None:
    """Name the arguments of a command that starts a farm."""
    parser.add_argument("--listen", default="", metavar="ENDPOINT", help="where others may join (a private socket)")
    parser.add_argument("--insecure", action="store_true", help=INSECURE)


def connecting(parser: argparse.ArgumentParser) -> None:
    """Name the arguments of a command that talks to a running farm, maybe one on another machine."""
    parser.add_argument("--connect", default="", metavar="ENDPOINT", help="farm without a run folder here")
    parser.add_argument("--campaign", default="", help="its campaign, with --connect")
    parser.add_argument("--insecure", action="store_true", help=INSECURE)


def where(args: argparse.Namespace) -> Where:
    """Return the farm the arguments of `connecting` and `--run` name."""
    return Where(args.run, args.connect, args.campaign, args.insecure)


def check(args: argparse.Namespace) -> None:
    """Raise Refused for a number of workers or an endpoint that makes no sense, before anything is made."""
    from saflite.bus.endpoints import check_endpoint
    from saflite.console.io import campaign_options

    if args.workers is not None:
        campaign_options.at_least("--workers", args.workers, 0 if args.listen else 1)
    if args.listen:
        check_endpoint(args.listen, insecure=args.insecure, argument="--listen")
