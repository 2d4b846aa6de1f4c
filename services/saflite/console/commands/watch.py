"""Show what happens in a campaign: every event from a sequence number on, none left out, none twice.

A run that works is followed until it ends; of one that does not, the events its books hold are shown.

With --webhook each event is posted to a web server instead, in order and until it is taken, over restarts of all three.
From a farm elsewhere (--connect) events are fetched as they come and wait beside the cursor while the receiver is away.

examples:
  saflite watch runs/avoidance-m2
  saflite watch runs/avoidance-m2 --from 200 --kind violation --json
  saflite watch runs/night --kind violation --webhook https://example.org/finds --secret hook.secret
  saflite watch --connect tcp/10.0.0.5:7447 --campaign night --insecure
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console.io import farm_options

if TYPE_CHECKING:
    from saflite.contract.events import Event


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    arguments.add_run(parser)
    parser.add_argument("--from", dest="from_seq", type=int, default=1, metavar="SEQ", help="first event (1: all)")
    parser.add_argument("--kind", action="append", default=[], help="only this kind (may be repeated)")
    farm_options.connecting(parser)
    parser.add_argument("--webhook", default="", metavar="URL", help="POST each event there (CloudEvents) until taken")
    parser.add_argument("--secret", type=Path, metavar="FILE", help="sign what is posted with the secret in this file")
    parser.add_argument("--cursor", type=Path, metavar="FILE", help="how far the webhook was told (in the run folder)")
    arguments.add_patience(parser, "with --webhook and --connect: end once the farm was silent for so long")
    receiver = "with --webhook: end once the campaign is over and nothing was taken for so long (300; 0: never)"
    parser.add_argument("--receiver-patience", type=arguments.patience_s, default=300.0, metavar="S", help=receiver)
    parser.add_argument("--json", action="store_true", help="one JSON object per event")


def run(args: argparse.Namespace) -> int:
    """Print events until the campaign ends; 1 if a confirmed violation was among them."""
    from saflite.console.view import out
    from saflite.console.view.event_lines import event_line
    from saflite.contract.errors import Refused
    from saflite.contract.events import KINDS, ViolationFound, kind_of

    for kind in args.kind:
        if kind not in KINDS:
            raise Refused("--kind", expected=f"one of {', '.join(KINDS)}", got=repr(kind))
    if args.webhook:
        return _bridged(args)
    found = False
    try:
        for event in _events(args):
            fact = event.fact
            found = found or (isinstance(fact, ViolationFound) and fact.violation.confirmation == "confirmed")
            if args.kind and kind_of(fact) not in args.kind:
                continue
            out.json(event) if args.json else out.line(event_line(event))
            out.flush()
    except KeyboardInterrupt:
        out.line()
    return int(found)


def _bridged(args: argparse.Namespace) -> int:
    from saflite.console.io import campaign_options
    from saflite.console.operations import bridging
    from saflite.console.view import out

    campaign_options.at_least("--receiver-patience", args.receiver_patience, 0.0)

    def say(text: str) -> None:
        out.line(text)
        out.flush()

    bridging.run(args, say)
    return 0


def _events(args: argparse.Namespace) -> Iterator[Event]:
    from saflite.console.io import campaign_options
    from saflite.console.run_data import farm_lookup
    from saflite.console.run_data.run_folder import open_run

    campaign_options.at_least("--from", args.from_seq, 0)
    run_dir = args.run
    if not args.connect:
        run_dir = farm_lookup.newest(run_dir)
        if not farm_lookup.says_it_runs(run_dir):
            with open_run(run_dir) as run_folder:
                _check_from(args.from_seq, next((event.seq for event in run_folder.last_events(1)), 0))
                yield from run_folder.events(args.from_seq)
            return
    client = farm_lookup.connect(farm_options.where(args)._replace(run_dir=run_dir))
    try:
        if args.from_seq > 1:
            _check_from(args.from_seq, client.status().seq)
        yield from client.watch(max(1, args.from_seq))
    finally:
        client.close()


def _check_from(from_seq: int, last_seq: int) -> None:
    """Raise Refused for a number beyond the next event, which is the last that anybody can wait for."""
    from saflite.contract.errors import Refused

    if from_seq > last_seq + 1:
        expected = f"at most {last_seq + 1}: the run has {last_seq} event{'' if last_seq == 1 else 's'}"
        raise Refused("--from", expected=expected, got=from_seq)
