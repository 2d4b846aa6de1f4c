"""Hold a part from outside to what its kind promises, check by check.

The suites are importable, too: `saflite.conformance`. Exit code 1 if a check does not hold.

examples:
  saflite conformance target reference
  saflite conformance target point_mass --module point_mass.py
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saflite.conformance.kit import Check


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("kind", choices=sorted(SUITES), help="what it is")
    parser.add_argument("name", help="its name")
    arguments.add_modules(parser)
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    """Run every check of the suite and print what does not hold."""
    from saflite.conformance.kit import findings
    from saflite.console.view import out

    found = {}
    for check in SUITES[args.kind](args.name, args.module):
        found[check.name] = [finding.text for finding in findings([check])]
        if not args.json:
            out.line(f"{'ok  ' if not found[check.name] else 'BAD '}  {check.name.replace('_', ' ')}")
            for text in found[check.name]:
                out.line(f"        {text}")
            out.flush()
    if args.json:
        out.json(found)
    return int(any(found.values()))


def _target(name: str, modules: Sequence[Path]) -> Sequence[Check]:
    from saflite.conformance.targets import checks_of
    from saflite.simulator_worker.registry import load_target

    return checks_of(load_target(name, modules))


SUITES: dict[str, Callable[[str, Sequence[Path]], Sequence[Check]]] = {"target": _target}
