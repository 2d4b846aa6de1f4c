"""List what there is: campaigns, missions, strategies, scorers, policies, targets and what each takes, exports.

examples:
  saflite list
  saflite list strategies -v
  saflite list policies --json
  saflite list parameters --target reference
"""

from __future__ import annotations

import argparse


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("kind", nargs="?", default="", help="what to list; nothing: how many there are of each kind")
    arguments.add_modules(parser)
    parser.add_argument("--target", default="", help="whose inputs, signals and settings (the default target's)")
    parser.add_argument("-v", "--verbose", action="store_true", help="show settings and details")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the catalogue."""
    from saflite.console.view import catalogue, out
    from saflite.contract.test_case import DEFAULT_TARGET

    target = args.target or DEFAULT_TARGET
    if not args.kind:
        counts = {kind: catalogue.names(kind, target) for kind in catalogue.kinds()}
        if args.json:
            out.json(counts)
        else:
            out.table([(kind, len(names), _few(names)) for kind, names in counts.items()])
        return 0
    items = catalogue.items(args.kind, target)
    if args.json:
        out.json([{"name": item.name, "summary": item.summary, "details": dict(item.details)} for item in items])
        return 0
    width = max((len(item.name) for item in items), default=0)
    for item in items:
        out.line(out.folded(f"{item.name:<{width}}  ", item.summary))
        for key, text in item.details.items() if args.verbose else ():
            out.line(out.folded(f"{'':<{width}}    {key}: ", text))
    if args.kind == "policies":
        out.line(catalogue.policies_told(target))
    return 0


def _few(names: list[str]) -> str:
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
