"""Write a working template of a policy, campaign, strategy, scorer or target of your own.

A target comes with a policy and a campaign, so that it can be searched at once. What to do next is printed.

examples:
  saflite new policy stays-below
  saflite new strategy my_strategy
  saflite new target my_vehicle --out vehicle/
"""

from __future__ import annotations

import argparse
from pathlib import Path

from saflite.console.io import outputs

KINDS = ("policy", "campaign", "strategy", "scorer", "target")


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("kind", choices=KINDS, help="what to begin")
    parser.add_argument("name", help="its name: with dashes for files of rules, with underscores for modules")
    parser.add_argument("--out", type=Path, default=Path(), metavar="FOLDER", help="folder to write to (here)")
    outputs.add_force(parser)
    parser.add_argument("--json", action="store_true", help="print the files as JSON")


def run(args: argparse.Namespace) -> int:
    """Write the files and say what to do with them."""
    from saflite.console.operations import beginning
    from saflite.console.view import out

    files = beginning.begin(args.kind, args.name, args.out, force=args.force)
    following = beginning.after(args.kind, args.name)
    if args.json:
        out.json({"files": [str(path) for path in files], "next": following})
        return 0
    for path in files:
        out.line(str(path))
    out.line("next:" if args.out == Path() else f"next, in {args.out}:")
    for text in following:
        out.line(f"  {text}")
    return 0
