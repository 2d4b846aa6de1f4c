"""Write the report of a run: one HTML file with a picture of every violation, readable anywhere.

examples:
  saflite report runs/avoidance-m2
  saflite report runs/avoidance-m2 --out /tmp/report.html
"""

from __future__ import annotations

import argparse
from pathlib import Path

from saflite.console.io import embargo, outputs


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    arguments.add_run(parser)
    parser.add_argument("--out", type=Path, help="where to (RUN/report.html)")
    embargo.add_release(parser)
    outputs.add_force(parser)
    parser.add_argument("--json", action="store_true", help="print where it was written as JSON")


def run(args: argparse.Namespace) -> int:
    """Write the report; 0 once it is written, whatever it tells."""
    from saflite.console.run_data import farm_lookup, reporting
    from saflite.console.run_data.run_folder import tell_loss
    from saflite.console.run_data.unproven import unproven_words
    from saflite.console.view import out
    from saflite.contract.plain import counted

    args.run = farm_lookup.newest(args.run)
    if args.out is not None:
        outputs.check_file(args.out, force=args.force)
    tell_loss(args.run)
    path, found = reporting.write(args.run, args.out, force=args.force, released=args.release)
    confirmed = found.finds_shown("confirmed")
    if args.json:
        told = [{"fingerprint": one.violation.fingerprint, "asked_first": one.circumstances} for one in found.exhibits]
        counts = {"confirmed": confirmed, "unproven": found.unproven, "withheld": found.withheld}
        out.json({"report": str(path), **counts, "findings": told})
    else:
        unproven = f"; {unproven_words(found.unproven)}" if found.unproven else ""
        out.line(f"{path}  ({counted(confirmed, 'confirmed violation')}{unproven})")
        embargo.tell(found.withheld)
    return 0
