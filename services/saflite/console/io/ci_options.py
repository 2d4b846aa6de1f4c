"""Arguments for the files that continuous integration reads. Imports nothing heavy: every `--help` comes by here."""

from __future__ import annotations

import argparse
from pathlib import Path

from saflite.console.io import outputs


def add_options(parser: argparse.ArgumentParser) -> None:
    """Name the files a command may write for continuous integration."""
    parser.add_argument("--junit", type=Path, metavar="FILE", help="write the result as JUnit XML")
    parser.add_argument("--sarif", type=Path, metavar="FILE", help="write the result as SARIF")
    outputs.add_force(parser)


def check_options(args: argparse.Namespace) -> None:
    """Raise Refused for files that must not be written over, before anything is flown."""
    for option, path in (("--junit", args.junit), ("--sarif", args.sarif)):
        if path is not None:
            outputs.check_file(path, force=args.force, option=option)
