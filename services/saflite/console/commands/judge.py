"""Judge the recording or log of a flight by policies.

Takes a recording (.mcap), a stored trace (.trace), a PX4 log (.ulg) or an ArduPilot log (.bin). Recordings carry
their test case; the others need `--test-case` where a policy looks at obstacles.

examples:
  saflite judge flight.mcap
  saflite judge log.ulg --test-case case.yaml
  saflite judge log.bin --policy a-rtl1 --policy a-chute --json
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saflite.contract.flight import Flight, Trace
    from saflite.contract.test_case import TestCase


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    parser.add_argument("file", type=Path, help="recording or log: .mcap, .trace, .ulg, .bin")
    parser.add_argument("--test-case", type=Path, help="what was flown: .yaml, .json or .mcap")
    parser.add_argument("--policy", action="append", default=[], help="policy to judge by; all there are if none named")
    parser.add_argument("--all", action="store_true", help="show policies that say nothing of this flight, and why")
    parser.add_argument("--json", action="store_true", help="print the judgement as JSON")


def run(args: argparse.Namespace) -> int:
    """Judge and print; 1 if a policy was violated."""
    from saflite.console.operations import judging
    from saflite.console.view import out
    from saflite.oracle.judge import judge
    from saflite.oracle.policy import policy_names

    case, flight, trace = _read(args.file, args.test_case)
    judgement = judge(case, flight, trace, tuple(args.policy) or policy_names())
    if args.json:
        out.json(judgement)
    else:
        judging.show(case, flight, judgement, args.all)
    return judging.exit_code(judgement)


def _read(path: Path, case_path: Path | None) -> tuple[TestCase, Flight, Trace]:
    from saflite.console.io import cases, log_files
    from saflite.contract.errors import Refused
    from saflite.flight.logs.files import READERS, read_trace
    from saflite.recorder import recording

    if path.suffix == ".mcap":
        found = recording.read(path)
        return (cases.load_case(case_path) if case_path else found.test_case), found.flight, found.trace
    if path.suffix not in READERS:
        expected = f".mcap, {', '.join(READERS)}"
        raise Refused("flight log", where=str(path), expected=expected, got=path.suffix or "no suffix")
    case = log_files.flown_by(path, cases.load_case(case_path)) if case_path else log_files.empty_case(path)
    trace = read_trace(path)
    return case, log_files.flight_of(case, trace), trace
