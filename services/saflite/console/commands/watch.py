"""Show what happens in a campaign: every event from a sequence number on, none left out, none twice.

A run that works is followed until it ends; of one that does not, the events its books hold are shown.

With --webhook each event is posted to a web server instead, in order and until it is taken, over restarts of all three.

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
    from saflite.contract.events import Event, Judged, WorkerChanged


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
    parser.add_argument("--json", action="store_true", help="one JSON object per event")


def run(args: argparse.Namespace) -> int:
    """Print events until the campaign ends; 1 if a confirmed violation was among them."""
    from saflite.console.view import out
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
            out.json(event) if args.json else out.line(_line(event))
            out.flush()
    except KeyboardInterrupt:
        out.line()
    return int(found)


def _bridged(args: argparse.Namespace) -> int:
    from saflite.console.operations import bridging
    from saflite.console.view import out

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
                yield from run_folder.events(args.from_seq)
            return
    client = farm_lookup.connect(farm_options.where(args)._replace(run_dir=run_dir))
    try:
        yield from client.watch(max(1, args.from_seq))
    finally:
        client.close()


def _line(event: Event) -> str:
    import msgspec

    from saflite.console.view import live
    from saflite.contract.events import Flown, Judged, WorkerChanged, kind_of
    from saflite.contract.plain import word

    fact = event.fact
    text = live.fact_text(fact)
    if isinstance(fact, Flown):
        text = f"flown  {fact.test_case}/{fact.flight_index} {fact.ending} {fact.simulated_s:.0f} s by {fact.worker}"
    elif isinstance(fact, Judged):
        text = f"judged  {fact.test_case}/{fact.flight_index} {_said(fact)} {' '.join(fact.violated)}".rstrip()
    elif isinstance(fact, WorkerChanged):
        text = _change(fact)
    elif not text:
        values = {key: value for key, value in msgspec.to_builtins(fact).items() if key != "type"}
        text = f"{kind_of(fact)}  " + " ".join(f"{key}={_short(value)}" for key, value in values.items() if value != "")
    return f"{event.seq:6d}  {word(text)}"


def _change(fact: WorkerChanged) -> str:
    if not fact.present:
        return f"left  {fact.worker} ({fact.stage}): {fact.message}"
    build = f", build {fact.build[:12]}" if fact.build else ""
    return f"joined  {fact.worker} ({fact.stage}) on {fact.host}{build}"


def _said(fact: Judged) -> str:
    from saflite.contract.verdict import NEVER_APPLIED

    if fact.robustness is not None:
        return f"{fact.robustness:+.2f}"
    return f"vacuous: {NEVER_APPLIED}" if fact.vacuous else "inconclusive"


def _short(value: object) -> str:
    return f"{len(value)} items" if isinstance(value, list | dict) else str(value)
