"""Check the books of a run: everything issued has ended, nothing was counted twice, nothing acknowledged is missing.

The journal is the one truth. What is audited is that all other tables say what it says, and that every blob the books
name (traces, artefacts, recordings) is there with the bytes its digest names. `--rebuild` makes the tables anew first.
Exit code 0 if the books balance, 3 if they do not.

examples:
  saflite audit runs/avoidance-m2
  saflite audit runs/avoidance-m2 --quick --json
  saflite audit runs/avoidance-m2 --rebuild
"""

from __future__ import annotations

import argparse


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    arguments.add_run(parser)
    parser.add_argument("--quick", action="store_true", help="only look whether blobs are there in full length")
    parser.add_argument("--rebuild", action="store_true", help="first make all tables anew from the journal")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Audit and print the figures."""
    import msgspec

    from saflite.campaign.storage.audit import audit
    from saflite.console.run_data import farm_lookup
    from saflite.console.view import out

    args.run = farm_lookup.newest(args.run)
    if args.rebuild:
        from saflite.campaign.storage.rebuild import rebuild

        lines = rebuild(args.run)
        if not args.json:
            out.line(f"all tables were made anew from {lines} journal entries")
    figures = msgspec.to_builtins(audit(args.run, quick=args.quick))
    if args.json:
        out.json(figures)
        return 0 if figures["clean"] else 3
    width = max(len(name) for name in figures)
    for name, value in figures.items():
        if isinstance(value, list):
            out.line(f"{name:<{width}}  {len(value)}")
            for item in value[:20]:
                out.line(f"{'':<{width}}    {item}")
        elif name != "clean":
            out.line(f"{name:<{width}}  {value}")
    out.line("the books balance" if figures["clean"] else "THE BOOKS DO NOT BALANCE")
    return 0 if figures["clean"] else 3
