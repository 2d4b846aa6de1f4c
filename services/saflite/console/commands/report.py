"""Write the report of a run: one HTML file with a picture of every violation, readable anywhere.

examples:
  saflite report runs/avoidance-m2
  saflite report runs/avoidance-m2 --out /tmp/report.html
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("--out", type=Path, help="where to (RUN/report.html)")
    parser.add_argument("--json", action="store_true", help="print where it was written as JSON")


def run(args: argparse.Namespace) -> int:
    """Write the report; 0 once it is written, whatever it tells."""
    from saflite.console.run_data import reporting
    from saflite.console.run_data.run_folder import tell_loss
    from saflite.console.view import out

    tell_loss(args.run)
    path, confirmed = reporting.write(args.run, args.out)
    if args.json:
        out.json({"report": str(path), "confirmed": confirmed})
    else:
        out.line(f"{path}  ({confirmed} confirmed violations)")
    return 0
