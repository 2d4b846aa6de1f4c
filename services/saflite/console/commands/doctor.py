"""Check one by one what a farm needs: packages, compiled code, JSBSim, bus, disk, targets, model server.

Each line says ok, or what is wrong and how to mend it. Each target is flown, twice where it says that its flights
repeat bit by bit, and held to what it says of itself. A missing model server or real autopilot is only noted: the farm
runs without. Exit code 3 if something needed is missing or a target does not do what it says.
"""

from __future__ import annotations

import argparse
from pathlib import Path


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("--dir", type=Path, default=Path("."), help="where runs will be written (.)")
    arguments.add_modules(parser)
    parser.add_argument("--ollama", default="", metavar="URL", help="model server to look for")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    """Run every check and print what it found."""
    from saflite.console.doctor import checks
    from saflite.console.view import out

    marks = {"ok": "ok  ", "note": "note", "bad": "BAD "}
    findings = []
    for check in checks.all_checks(args.dir, args.ollama):
        finding = check()
        findings.append(finding)
        if not args.json:
            out.line(f"{marks[finding.state]}  {finding.what:<18} {finding.text}")
            out.flush()
    if args.json:
        out.json([finding._asdict() for finding in findings])
    return 3 if any(finding.state == "bad" for finding in findings) else 0
