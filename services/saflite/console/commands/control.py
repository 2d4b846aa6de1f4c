"""Pause, resume or stop a running campaign, change its budget, or ask how it goes.

examples:
  saflite control status
  saflite control pause
  saflite control budget 500 runs/avoidance-m2
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from saflite.console.io import farm_options

if TYPE_CHECKING:
    from saflite.contract.control import Status

WORKERS_TOLD = 40
DIGITS_MAX = 18  # of a number; what they say is bounded by the books


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("verb", choices=["status", "pause", "resume", "stop", "budget"], help="the order")
    words = "the new budget, with `budget`; then the run folder (the one that runs)"
    parser.add_argument("words", nargs="*", metavar="NUMBER RUN", help=words)
    farm_options.connecting(parser)
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def run(args: argparse.Namespace) -> int:
    """Give the order and print the answer."""
    from saflite.console.run_data import farm_lookup
    from saflite.console.view import live, out
    from saflite.contract.errors import RefusedElsewhere

    words, args.run = farm_lookup.last_as_run(args.words)
    number = _number(args.verb, words)
    client = farm_lookup.connect(farm_options.where(args), reads=args.verb == "status")
    try:
        answer = client.order(args.verb, number=number)
    finally:
        client.close()
    if not answer.accepted:
        raise RefusedElsewhere(args.verb, answer.message)
    if args.json:
        out.json(answer)
    elif answer.status is not None:
        out.line(live.one_line(answer.status))
        if args.verb == "status":
            _tell_workers(answer.status)
    else:
        out.line(answer.message or f"{args.verb}: done")
    return 0


def _tell_workers(status: Status) -> None:
    """Write what each worker does, those first that were not heard of for longest."""
    from saflite.console.view import out

    longest = sorted(status.workers, key=lambda one: -one.silent_s)[:WORKERS_TOLD]
    rows = [
        (one.worker, one.stage, one.state, one.done, f"{one.busy_share:.0%}", f"{one.silent_s:.1f} s", one.host)
        for one in longest
    ]
    out.table(rows, ("worker", "stage", "state", "done", "busy", "silent", "host") if rows else (), indent="  ")
    if len(status.workers) > len(longest):
        out.line(f"  and {len(status.workers) - len(longest)} more (--json tells of all)")


def _number(verb: str, words: list[str]) -> int:
    """Return the number that goes with an order, 0 for one without; raises Refused for one too many or too few."""
    from saflite.console.io import campaign_options
    from saflite.contract.errors import Refused

    where = f"saflite control {verb}"
    if verb != "budget":
        if words:
            raise Refused("run folder", where=where, expected="one that is there, and nothing else", got=_said(words))
        return 0
    fix = "saflite control budget 500 RUN"
    if not words:
        raise Refused("budget", where=where, expected="a whole number of flights", got="none", fix=fix)
    if len(words) > 1 or not words[0].isdecimal() or len(words[0]) > DIGITS_MAX:
        expected = f"a whole number of flights of at most {DIGITS_MAX} digits, then the run folder"
        raise Refused("budget", where=where, expected=expected, got=_said(words), fix=fix)
    campaign_options.at_least("budget", int(words[0]), 1)
    return int(words[0])


def _said(words: list[str]) -> str:
    from saflite.contract.plain import cut

    return repr(cut(" ".join(words), 80))
