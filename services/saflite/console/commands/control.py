"""Pause, resume or stop a running campaign, change its budget, or ask how it goes.

examples:
  saflite control status
  saflite control pause
  saflite control budget 500 --run runs/avoidance-m2
"""

from __future__ import annotations

import argparse
from pathlib import Path

from saflite.console.io import farm_options


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("verb", choices=["status", "pause", "resume", "stop", "budget"], help="the order")
    parser.add_argument("number", type=int, nargs="?", default=0, help="the new budget")
    parser.add_argument("--run", type=Path, help="run folder (the newest running one)")
    farm_options.connecting(parser)
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def run(args: argparse.Namespace) -> int:
    """Give the order and print the answer."""
    from saflite.console.io import campaign_options
    from saflite.console.run_data import farm_lookup
    from saflite.console.view import live, out
    from saflite.contract.errors import Refused

    if args.verb == "budget":
        campaign_options.at_least("budget", args.number, 1)
    client = farm_lookup.connect(farm_options.where(args))
    try:
        answer = client.order(args.verb, number=args.number)
    finally:
        client.close()
    if not answer.accepted:
        raise Refused(args.verb, expected="an order the books accept", got=answer.message)
    if args.json:
        out.json(answer)
    elif answer.status is not None:
        out.line(live.one_line(answer.status))
    else:
        out.line(answer.message or f"{args.verb}: done")
    return 0
