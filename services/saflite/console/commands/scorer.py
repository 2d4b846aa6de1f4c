"""See and change the scorer model of a running campaign.

`use` warms the new model, flips between two batches and rolls back if it does not answer; `shadow` lets others score
the same batches without deciding; `list` shows what scores, how well it did so far, and what it took.

examples:
  saflite scorer use ollama:mistral
  saflite scorer shadow surrogate novelty runs/avoidance-m2
  saflite scorer list
"""

from __future__ import annotations

import argparse
from pathlib import Path

from saflite.console.io import farm_options


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="use|shadow|list")
    use = verbs.add_parser("use", help="let another model decide")
    use.add_argument("model", help="see `saflite list scorers`; e.g. ollama:mistral")
    use.add_argument("run", type=Path, nargs="?", metavar="RUN", help="run folder (the one that runs)")
    use.add_argument("--no-wait", action="store_true", help="do not wait until it has taken over")
    shadow = verbs.add_parser("shadow", help="let models score without deciding")
    shadow.add_argument("model", nargs="*", help="models; none: no shadow scoring; then the run folder")
    listing = verbs.add_parser("list", help="what scores, with live calibration")
    listing.add_argument("run", type=Path, nargs="?", metavar="RUN", help="run folder (the newest)")
    for verb in (use, shadow, listing):
        farm_options.connecting(verb)
        verb.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    """Give the order, or show what scores."""
    from saflite.console.operations import scoring
    from saflite.console.run_data import farm_lookup

    if args.verb == "shadow":
        args.model, args.run = farm_lookup.last_as_run(args.model)
    if args.verb == "list":
        return scoring.show(farm_options.where(args), args.json)
    if args.verb == "use":
        return scoring.use(args)
    return scoring.shadow(args)
