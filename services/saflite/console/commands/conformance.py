"""Hold a part from outside to what its kind promises, check by check.

The suites are importable, too: `saflite.conformance`. Exit code 1 if a check does not hold.

examples:
  saflite conformance target reference
  saflite conformance target point_mass --module point_mass.py
  saflite conformance strategy my_strategy --module my_strategy.py
  saflite conformance scorer gap
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
    parser.add_argument("--limit", type=float, default=120.0, metavar="S", help="a check ends within so long (120)")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    """Run every check of the suite and print what does not hold."""
    from saflite.conformance.apart import findings_apart
    from saflite.console.io import campaign_options
    from saflite.console.view import out

    campaign_options.at_least("--limit", args.limit, 1)
    found = {}
    for name, wrong in findings_apart(SUITES[args.kind](args.name, args.module), args.limit):
        found[name] = wrong
        if not args.json:
            out.line(f"{'ok  ' if not wrong else 'BAD '}  {name.replace('_', ' ')}")
            for text in wrong:
                out.line(f"        {text}")
            out.flush()
    if args.json:
        out.json(found)
    return int(any(found.values()))


def _target(name: str, modules: Sequence[Path]) -> Sequence[Check]:
    from saflite.conformance.targets import checks_of
    from saflite.simulator_worker.registry import describe_target, load_target

    describe_target(name, modules)
    return checks_of(load_target(name, modules))


def _strategy(name: str, modules: Sequence[Path]) -> Sequence[Check]:
    from saflite.conformance.strategies import Setup, check_strategy
    from saflite.contract.test_case import DEFAULT_TARGET
    from saflite.mutator.registry import load_strategy
    from saflite.simulator_worker.registry import describe_target

    return check_strategy(Setup(name, load_strategy(name), describe_target(DEFAULT_TARGET)))


def _scorer(name: str, modules: Sequence[Path]) -> Sequence[Check]:
    from saflite.conformance.scorers import check_scorer, open_model
    from saflite.scorer_pool.registry import check_label

    check_label(name)
    return check_scorer(lambda: open_model(name))


SUITES: dict[str, Callable[[str, Sequence[Path]], Sequence[Check]]] = {
    "target": _target,
    "strategy": _strategy,
    "scorer": _scorer,
}
