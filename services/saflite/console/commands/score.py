"""Score test cases with a scorer model, as the farm's scorer pool does.

examples:
  saflite score cases/*.yaml
  saflite score cases/*.json --scorer ollama:mistral --policy min-obstacle-distance --json
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saflite.contract.test_case import TestCase


def configure(parser: argparse.ArgumentParser) -> None:
    """Name the arguments."""
    from saflite.console.io import arguments

    parser.add_argument("cases", type=Path, nargs="+", help="test cases: .yaml, .json, .mcap or .plan")
    parser.add_argument("--scorer", default="blend", help="scorer model (see `saflite list scorers`)")
    arguments.add_policy(parser, "policy to score for (min-obstacle-distance)")
    arguments.add_modules(parser)
    parser.add_argument("--deadline", type=arguments.deadline_s, default=60.0, metavar="S", help="seconds to answer in")
    parser.add_argument("--rng-seed", type=arguments.rng_seed, default=1, help="random seed")
    parser.add_argument("--json", action="store_true", help="print scores and usage as JSON")


def run(args: argparse.Namespace) -> int:
    """Score one batch and print it, the most interesting first."""
    from saflite.console.io import campaign_options
    from saflite.console.view import out
    from saflite.contract.score import band
    from saflite.contract.work import ScoreResult, ScoreWork
    from saflite.runtime.clock import WallClock
    from saflite.runtime.stages import brief_of
    from saflite.scorer_pool.registry import check_label
    from saflite.scorer_pool.work import open_service

    check_label(args.scorer)
    campaign_options.check_policies(args.policy)
    work = ScoreWork(
        round=0,
        model=args.scorer,
        shadow=(),
        policies=tuple(args.policy) or ("min-obstacle-distance",),
        test_cases=tuple(_checked(path) for path in args.cases),
        rng_seed=args.rng_seed,
        deadline_s=args.deadline,
    )
    pool = open_service(brief_of, WallClock())
    try:
        result = pool.do(work, lambda: False)
    finally:
        pool.close()
    assert isinstance(result, ScoreResult)
    if args.json:
        out.json(result)
        return 0
    named = sorted(zip(result.scores, args.cases, strict=True), key=lambda pair: -pair[0].value)
    rows = [
        (f"{score.value:.2f}", band(score.value), str(path), score.reason[:80], score.fault and f"[{score.fault}]")
        for score, path in named
    ]
    out.table(rows)
    answered = sorted({score.scored_by for score in result.scores})
    out.line(f"asked {args.scorer}, answered by {', '.join(answered)}")
    return 0


def _checked(path: Path) -> TestCase:
    from saflite.console.io import cases

    case = cases.load_case(path)
    cases.check_layout(case, str(path))
    return case
