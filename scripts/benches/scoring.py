"""`scripts/bench scoring`: what scoring costs, how well it overlaps with flying, swaps, and what each model is worth.

    scripts/bench scoring [--part surrogate cheap overlap cascade swaps first deep] [--seeds 20] [--jobs 2] [--json]

Parts: `surrogate` learning and scoring times; `cheap` screens and kinematic flights a second; `overlap` a scorer of ten
seconds a batch, beside the serial loop of the paper (at most 60 flights: its rounds are all alike); `cascade` wall time
with servers of several speeds against none; `swaps` fifty
changes of the scorer under load; `first` flights to the first confirmed violation per embedded model: it takes about
half a minute per mission and seed on one core, and its counts do not depend on how busy the machine is; `deep` whether
real flights come below 0.25 m where cheap flights do (rows in `--out`, results/deep.jsonl if left out).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

SERIAL_FLIGHTS_MAX = 60
CASCADE_FLIGHTS_MAX, CASCADE_BATCHES_S = 60, (2.0, 10.0, 60.0)
PARTS = ("surrogate", "cheap", "overlap", "cascade", "swaps", "first", "deep")


def main(argv: list[str]) -> int:
    """Measure the parts asked for and print them."""
    parser = argparse.ArgumentParser(prog="scripts/bench scoring", description=__doc__)
    parser.add_argument("--part", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--missions", type=int, nargs="+", default=[2, 3, 4, 5])
    parser.add_argument("--models", nargs="+")
    parser.add_argument("--jobs", type=int, default=1, help="processes for `first`: one per core")
    parser.add_argument("--flights", type=int, default=300, help="budget of the overlap campaign")
    parser.add_argument("--swaps", type=int, default=50)
    parser.add_argument(
        "--out", type=Path, help="note campaigns of `first` and flights of `deep` here; those in it are not run again"
    )
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    found = {part: _measure(part, options) for part in options.part}
    if options.json:
        print(json.dumps(found, indent=2))
    else:
        for part, figures in found.items():
            _print(part, figures)
    return 0


def _measure(part: str, options: argparse.Namespace) -> Any:
    sys.stderr.write(f"measuring {part} ...\n")
    if part == "surrogate":
        return surrogate()
    if part == "cheap":
        return cheap()
    if part == "first":
        from _scoring_first import MODELS, table

        return table(options.missions, options.seeds, options.models or MODELS, options.jobs, options.out)
    if part == "deep":
        from _scoring_deep import deep_table, fly_all, rows_in

        rows = options.out or Path(__file__).parent / "results" / "deep.jsonl"
        fly_all(options.missions, rows)
        return deep_table(rows_in(rows))
    if part == "overlap":
        from _scoring_farm import overlap

        return {
            "overlapped": overlap(options.flights, 3),
            "serial": overlap(min(options.flights, SERIAL_FLIGHTS_MAX), 1),
        }
    if part == "cascade":
        from _scoring_farm import cascade

        return cascade(min(options.flights, CASCADE_FLIGHTS_MAX), CASCADE_BATCHES_S)
    from _scoring_swaps import swaps

    return swaps(options.swaps)


def _cases(count: int, seed: int) -> list[Any]:
    """Return layouts as the built-in strategy draws them for mission 2."""
    from saflite.campaign.presets.campaigns import load_campaign, template
    from saflite.contract.rng import derive
    from saflite.flight.autopilots.reference.describe import describe
    from saflite.mutator.strategies import random_boxes

    campaign = load_campaign("avoidance-m2")
    strategy = random_boxes.Strategy(template(campaign), {}, campaign.policies, describe())
    return list(strategy.ask(count, derive(seed, "bench scoring")))


def surrogate() -> dict[str, float]:
    """Return seconds to learn from 2,000 flights and to score 200 test cases never seen (features included)."""
    from saflite.contract.work import Outcome
    from saflite.runtime.clock import WallClock
    from saflite.scorer_pool.geometry_score import look
    from saflite.scorer_pool.model import Job, Tools
    from saflite.scorer_pool.registry import make

    def tools() -> Tools:
        return Tools(WallClock(), lambda label: make(label, tools()))

    cases, asked = _cases(2000, 1), _cases(200, 2)
    margins = [8.0 - look(case.scenario).score for case in cases]
    history = tuple(
        Outcome(
            test_case=case,
            round=place // 8,
            ending="completed",
            robustness=margin,
            violated=("p",) if margin < 1 else (),
        )
        for place, (case, margin) in enumerate(zip(cases, margins, strict=True))
    )
    model = make("surrogate", tools())
    model.warm(lambda: False)
    started_s = time.perf_counter()
    model.score(Job((), (), 1, 250, history, 249))
    learned_s = time.perf_counter() - started_s
    started_s = time.perf_counter()
    model.score(Job(tuple(asked), (), 1, 250, history, 249))
    return {"flights": len(history), "learn_s": learned_s, "score_200_s": time.perf_counter() - started_s}


def cheap() -> dict[str, float]:
    """Return looks and kinematic flights per second on one core, and the simulated time per wall time."""
    from saflite.scorer_pool.geometry_score import look
    from saflite.scorer_pool.models.low_fidelity import _fly

    cases = _cases(400, 3)
    started_s = time.perf_counter()
    scores = np.array([look(case.scenario).score for case in cases])
    looked_s = time.perf_counter() - started_s
    started_s = time.perf_counter()
    flights = [_fly(case, 0) for case in cases[:60]]
    flown_s = time.perf_counter() - started_s
    return {
        "looks_per_s": len(cases) / looked_s,
        "share_flown_after_a_look": float((scores >= 2.0).mean()),
        "kinematic_missions_per_s": len(flights) / flown_s,
        "kinematic_times_real_time": sum(flight.duration_s for flight in flights) / flown_s,
    }


def _print(part: str, figures: Any) -> None:
    print(f"\n{part}")
    if isinstance(figures, dict) and all(isinstance(value, dict) for value in figures.values()):
        for name, inner in figures.items():
            print(f"  {name}")
            _lines(inner, "    ")
    elif isinstance(figures, dict):
        _lines(figures, "  ")
    else:
        for row in figures:
            print("  " + "  ".join(f"{key} {_short(value)}" for key, value in row.items()))


def _lines(figures: dict[str, Any], indent: str) -> None:
    for name, value in figures.items():
        print(f"{indent}{name:34} {_short(value)}")


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
