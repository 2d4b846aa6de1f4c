"""False alarms at the edges: inputs 0, 1 or 2 ticks apart, and inputs around what the autopilot does by itself.

    scripts/bench edges [--policies NAME ...] [--cases 200] [--rng-seed 1] [--json]
    scripts/bench edges --extremes [--cases 200] [--rng-seed 1] [--json]
    scripts/bench edges --disturbed [--inputs REGEX] [--cases 200] [--rng-seed 1] [--json]

For each policy at most `--cases` flights with all defects off (half of them inputs that meet, half inputs that meet a
change of state of the autopilot's own, fewer where it makes few), judged by all policies; every violation is a false
alarm. Cases stand in tests/replay/edge_cases.py. With --extremes so many flights with settings at the ends of their
ranges, or changed on the way, modes at one instant, failsafes raised and recovered, a wind that drops
(tests/replay/extreme_cases.py). With --disturbed procedures of all rules, and drawn missions, with one to three inputs
more in between, of all or of those whose name holds a pattern (tests/replay/disturbed_cases.py).
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from saflite.contract.test_case import TestCase, told_in_order

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "replay"))
import disturbed_cases
import edge_cases
import extreme_cases


def cases(options: argparse.Namespace) -> Iterator[tuple[str, TestCase]]:
    """Yield what is flown, each with its kind and the policy or number it is of."""
    if options.extremes:
        for number, case in enumerate(islice(extreme_cases.extremes(options.rng_seed), options.cases)):
            yield f"extremes {number}", case
        return
    if options.disturbed:
        drawn_ones = disturbed_cases.disturbed(options.rng_seed, options.inputs)
        for number, (what, case) in enumerate(islice(drawn_ones, options.cases)):
            yield f"disturbed {number} {what}", case
        return
    for policy in options.policies:
        for kind, drawn in (("meetings", edge_cases.meetings), ("reactions", edge_cases.reactions)):
            for case in islice(drawn(f"policy-{policy}", options.rng_seed), -(-options.cases // 2)):
                yield f"{kind} {policy}", case


def _pattern(text: str) -> str:
    try:
        re.compile(text)
    except re.error as fault:
        raise argparse.ArgumentTypeError(f"expected a regular expression, got {text!r}: {fault}") from fault
    return text


def main(argv: list[str]) -> int:
    """Fly, judge and print; 1 where there was a false alarm."""
    known = [name.removeprefix("policy-") for name in edge_cases.campaigns()]
    parser = argparse.ArgumentParser(prog="scripts/bench edges", description=__doc__)
    parser.add_argument("--policies", nargs="+", choices=known, default=known, metavar="NAME")
    parser.add_argument("--extremes", action="store_true")
    parser.add_argument("--disturbed", action="store_true")
    parser.add_argument("--inputs", type=_pattern, default="", metavar="REGEX")
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--rng-seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    flown, alarms, start = Counter[str](), list[str](), time.process_time()
    for kind, case in cases(options):
        flown[kind.partition(" ")[0]] += 1
        told = edge_cases.broken(case)
        if told:
            alarms.append(f"{kind} {case.scenario.start} {told_in_order(case.stimuli)}: {'; '.join(told)}")
            sys.stderr.write(alarms[-1] + "\n")
    spent_s = round(time.process_time() - start, 1)
    if options.json:
        print(json.dumps({"cases": dict(flown), "alarms": alarms, "core_s": spent_s}))
    else:
        print(f"{len(alarms)} false alarms in {flown.total()} flights ({dict(flown)}), {spent_s} s of one core")
    return 1 if alarms else 0
