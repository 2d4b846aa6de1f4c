"""Export the violations of a run: competition YAML, SARIF, JUnit, CSV, QGroundControl plans.

examples:
  saflite export runs/avoidance-m2 --format yaml
  saflite export runs/avoidance-m2 --format sarif --out findings/
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("run", type=Path, help="run folder")
    parser.add_argument("--format", required=True, help="see `saflite list exports`")
    parser.add_argument("--out", type=Path, help="folder to write to (RUN/export-FORMAT)")
    parser.add_argument("--json", action="store_true", help="print the files as JSON")


def run(args: argparse.Namespace) -> int:
    """Write the files; 0 once they are written, whatever they tell."""
    from saflite.console.run_data.run_folder import open_run, tell_loss
    from saflite.console.view import out
    from saflite.recorder.export import export

    tell_loss(args.run)
    folder = args.out or args.run / f"export-{args.format}"
    with open_run(args.run) as run_folder:
        summary = run_folder.summary()
    files = export(args.format, summary, folder)
    if args.json:
        out.json({"files": [str(path) for path in files], "violations": len(summary.findings)})
    else:
        for path in files:
            out.line(str(path))
        out.line(f"{len(files)} files, {len(summary.findings)} violations")
        if summary.findings and not files:
            out.line(f"none of them has what {args.format} files hold (missions, boxes)")
    return 0
