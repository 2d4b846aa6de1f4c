"""Pause, resume or stop a running campaign, change its budget, or ask how it goes.

examples:
  saflite control status
  saflite control pause
  saflite control budget 500 runs/avoidance-m2
"""

from __future__ import annotations

import argparse

from saflite.console.io import farm_options

DIGITS_MAX = 18  # of a number; what they say is bounded by the books


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("verb", choices=["status", "pause", "resume", "stop", "budget"], help="the order")
    words = "the new budget, with `budget`; then the run folder (the newest running one)"
    parser.add_argument("words", nargs="*", metavar="NUMBER RUN", help=words)
    farm_options.connecting(parser)
    parser.add_argument("--json", action="store_true", help="print the answer as JSON")


def run(args: argparse.Namespace) -> int:
    """Give the order and print the answer."""
    from saflite.console.io import campaign_options
    from saflite.console.run_data import farm_lookup
    from saflite.console.view import live, out
    from saflite.contract.errors import Refused

    words, args.run = farm_lookup.last_as_run(args.words)
    if len(words) > int(args.verb == "budget") or not all(
        word.isdecimal() and len(word) <= DIGITS_MAX for word in words
    ):
        got = " ".join(args.words)[:200]
        raise Refused(args.verb, expected="a number with `budget`, then a run folder", got=got)
    number = int(words[0]) if words else 0
    if args.verb == "budget":
        campaign_options.at_least("budget", number, 1)
    client = farm_lookup.connect(farm_options.where(args))
    try:
        answer = client.order(args.verb, number=number)
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
