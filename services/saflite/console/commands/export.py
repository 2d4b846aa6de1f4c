"""Export the violations of a run: competition YAML, SARIF, JUnit, CSV, QGroundControl plans; or one recording.

A campaign records one find of each behaviour; `--recording` flies any other test case again, holds it against
its record bit by bit and writes its MCAP. `--standalone` writes a script for the maintainers of an autopilot, of the
smallest form of the finding that was confirmed.

examples:
  saflite export runs/avoidance-m2 --format yaml
  saflite export runs/avoidance-m2 --format sarif --out findings/
  saflite export runs/avoidance-m2 --recording 0123456789abcdef
  saflite export runs/betaflight-failsafe --standalone 0123456789abcdef
"""

from __future__ import annotations

import argparse
from pathlib import Path

from saflite.console.io import embargo, outputs


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    arguments.add_run(parser)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--format", help="see `saflite list exports`")
    words = "write a script that reproduces this finding without the farm (targets of real autopilots)"
    what.add_argument("--standalone", metavar="TEST_CASE", help=words)
    what.add_argument("--recording", metavar="TEST_CASE", help="fly this test case again and write its recording")
    parser.add_argument("--out", type=Path, help="folder to write to (RUN/export-FORMAT, RUN/export-recording)")
    arguments.add_autopilot(parser)
    embargo.add_release(parser)
    outputs.add_force(parser)
    parser.add_argument("--json", action="store_true", help="print the files as JSON")


def run(args: argparse.Namespace) -> int:
    """Write the files; 0 once they are written, whatever they tell."""
    from saflite.campaign.storage.own_folder import check_own
    from saflite.console.run_data import farm_lookup
    from saflite.console.run_data.run_folder import open_run, tell_loss
    from saflite.console.run_data.unproven import unproven_words
    from saflite.console.view import out
    from saflite.contract.plain import counted
    from saflite.recorder.export import export

    args.run = farm_lookup.newest(args.run)
    if args.out is not None:
        outputs.check_folder(args.out, force=args.force)
    else:
        check_own(args.run)  # what stands there for a folder may be a link of somebody else's
    tell_loss(args.run)
    if args.recording is not None:
        return _record(args)
    if args.standalone is not None:
        return _standalone(args)
    folder = args.out or args.run / f"export-{args.format}"
    with open_run(args.run) as run_folder:
        summary = run_folder.summary(args.release)
    files, finds = export(args.format, summary, folder), summary.finds()
    if args.json:
        counts = {"violations": len(finds), "unproven": summary.unproven, "withheld": summary.withheld}
        out.json({"files": [str(path) for path in files], **counts})
    else:
        for path in files:
            out.line(str(path))
        unproven = f"; {unproven_words(summary.unproven)}" if summary.unproven else ""
        out.line(f"{counted(len(files), 'file')}, {counted(len(finds), 'violation')}{unproven}")
        embargo.tell(summary.withheld)
        if finds and not files:
            out.line(f"none of them has what {args.format} files hold (missions, boxes)")
    return 0


def _standalone(args: argparse.Namespace) -> int:
    from saflite.console.operations.standalone import export_standalone
    from saflite.console.view import out

    paths = export_standalone(args.run, args.standalone, args.out or args.run / "export-standalone", args.release)
    if args.json:
        out.json({"files": [str(path) for path in paths]})
    else:
        for path in paths:
            out.line(str(path))
    return 0


def _record(args: argparse.Namespace) -> int:
    from saflite.console.operations.recording_again import WALL_LIMIT_S, record_again
    from saflite.console.view import out

    path = record_again(args.run, args.recording, args.out or args.run / "export-recording", WALL_LIMIT_S)
    if args.json:
        out.json({"files": [str(path)]})
    else:
        out.line(str(path))
    return 0
