"""Check the books of a run: everything issued has ended, nothing was counted twice, nothing acknowledged is missing.

Exit code 0 if the books balance, 3 if they do not.

examples:
  saflite audit runs/avoidance-m2
  saflite audit runs/avoidance-m2 --json
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Audit and print the figures."""
    import msgspec

    from saflite.campaign.storage.audit import audit
    from saflite.console.view import out

    figures = msgspec.to_builtins(audit(args.run))
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
