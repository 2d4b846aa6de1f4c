"""How faithful the avoidance flights are: free-flight times, simulated layouts, real flights.

Protocol: fit on one half of the layouts (split by hash), report the other. Simulated layouts (mission 2, unique
layouts, median of the seeds, 500 s): area under the ROC curve and rank correlation of simulation, of the gap between
the boxes, and of both, with bootstrap intervals over layouts. Real flights: same route, deviation, clearance of the
boxes other than the nearest, duration, correlation of the distance inside each tool; never a pooled area, which would
only tell the tools apart.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from _bootstrap import bootstrap_95
from _fidelity_data import HALVES, Layout, RealFlight, layouts, real_flights
from _fidelity_score import (
    Array,
    clearances,
    off_route,
    rank_correlation,
    same_route,
    within_tools,
)
from _fidelity_worlds import WORLDS, Flown, World
from numpy.typing import NDArray
from scipy.stats import rankdata

from saflite.contract.rng import derive
from saflite.flight.planner.gap import box_gaps
from saflite.scorer_pool.calibration import roc_area

FREE_FLIGHT_S = {"mission1": 85.0, "mission2": 134.0, "mission3": 147.0}
SAFE_M, LIMIT_S, REAL_LIMIT_S = 1.5, 500.0, 1000.0


class Compared(NamedTuple):
    """One real flight against its simulations: medians over the seeds."""

    deviation_m: float
    route_share: float
    real_others_m: list[float]
    flown_others_m: list[float]
    duration_s: float
    min_distance_m: float


def free_flight(world: World) -> dict[str, dict[str, float]]:
    """Return flown and real duration of the obstacle-free missions."""
    return {m: {"flown_s": world(m, (), 0, LIMIT_S).duration_s, "real_s": real} for m, real in FREE_FLIGHT_S.items()}


def median_distance(layout: Layout, world: World, seeds: int) -> float:
    """Return the median distance of one layout over the seeds."""
    return float(np.median([world("mission2", layout.obstacles, s, LIMIT_S).min_distance_m for s in range(seeds)]))


def judge_layouts(chosen: list[Layout], flown_m: Array) -> dict[str, object]:
    """Return area and rank correlation of simulation, gap and both, with intervals."""
    real_m = np.array([layout.min_distance_m for layout in chosen])
    gap_m = box_gaps(np.stack([layout.boxes for layout in chosen]))
    signals = {"simulation": flown_m, "gap": gap_m, "both": rankdata(flown_m) + rankdata(gap_m)}
    result: dict[str, object] = {"layouts": len(chosen), "failing": int((real_m < SAFE_M).sum())}
    for name, signal in signals.items():

        def area(index: NDArray[np.intp], signal: Array = signal) -> float:
            found = roc_area(real_m[index] < SAFE_M, -signal[index])
            return float("nan") if found is None else found

        def correlation(index: NDArray[np.intp], signal: Array = signal) -> float:
            return rank_correlation(real_m[index], signal[index])

        everything = np.arange(len(chosen))
        result[name] = {
            "area": area(everything),
            "area_95": bootstrap_95(area, len(chosen), derive(1, "fidelity", name, "area")),
            "rank_correlation": correlation(everything),
            "rank_correlation_95": bootstrap_95(correlation, len(chosen), derive(1, "fidelity", name, "rank")),
        }
    return result


def compare(flight: RealFlight, world: World, seeds: int) -> Compared:
    """Fly a real flight's layout with every seed and lay the tracks over the real one."""
    flown: list[Flown] = [world(flight.mission, flight.obstacles, seed, REAL_LIMIT_S) for seed in range(seeds)]
    apart = [off_route(flight.track[:, 1:], one.track) for one in flown]
    real_m = clearances(flight.track[:, 1:], flight.boxes)
    flown_m = np.median([clearances(one.track, flight.boxes) for one in flown], axis=0)
    others = [i for i in range(len(real_m)) if i != int(np.argmin(real_m))]
    return Compared(
        deviation_m=float(np.median([np.median(distances) for distances in apart])),
        route_share=float(np.mean([same_route(distances) for distances in apart])),
        real_others_m=[float(real_m[i]) for i in others],
        flown_others_m=[float(flown_m[i]) for i in others],
        duration_s=float(np.median([one.duration_s for one in flown])),
        min_distance_m=float(np.median([one.min_distance_m for one in flown])),
    )


def judge_flights(chosen: list[RealFlight], compared: list[Compared]) -> dict[str, object]:
    """Return the protocol's numbers over the real flights."""
    real_s, flown_s = np.array([f.duration_s for f in chosen]), np.array([c.duration_s for c in compared])
    real_m, flown_m = np.array([f.min_distance_m for f in chosen]), np.array([c.min_distance_m for c in compared])
    real_others = np.array([value for c in compared for value in c.real_others_m])
    flown_others = np.array([value for c in compared for value in c.flown_others_m])
    return {
        "flights": len(chosen),
        "same_route_share": float(np.mean([c.route_share for c in compared])),
        "median_deviation_m": float(np.median([c.deviation_m for c in compared])),
        "other_boxes_correlation": float(np.corrcoef(real_others, flown_others)[0, 1]),
        "other_boxes_rank_correlation": rank_correlation(real_others, flown_others),
        "duration_correlation": float(np.corrcoef(real_s, flown_s)[0, 1]),
        "duration_rank_correlation": rank_correlation(real_s, flown_s),
        "over_250_s_share": {"real": float((real_s > 250).mean()), "flown": float((flown_s > 250).mean())},
        "distance_rank_correlation_within_tools": within_tools([f.tool for f in chosen], real_m, flown_m),
        "below_1_5_m_share": {"real": float((real_m < SAFE_M).mean()), "flown": float((flown_m < SAFE_M).mean())},
    }


def measure(world_name: str, half: str, seeds: int, workers: int) -> dict[str, object]:
    """Run the whole protocol with one world."""
    world = WORLDS[world_name]()
    shapes = [layout for layout in layouts() if half in ("all", layout.half)]
    flights = [flight for flight in real_flights() if half in ("all", flight.half)]
    began = time.perf_counter()
    with ProcessPoolExecutor(workers) as pool:
        flown_m = np.array(list(pool.map(partial(median_distance, world=world, seeds=seeds), shapes)))
        compared = list(pool.map(partial(compare, world=world, seeds=seeds), flights))
    return {
        "world": world_name,
        "half": half,
        "seeds": seeds,
        "free_flight": free_flight(world),
        "simulated_layouts": judge_layouts(shapes, flown_m),
        "real_flights": judge_flights(flights, compared),
        "wall_s": time.perf_counter() - began,
    }


def show(value: object, name: str = "", depth: int = 0) -> None:
    """Print nested results one per line."""
    pad = "  " * depth
    if isinstance(value, dict):
        if name:
            sys.stdout.write(f"{pad}{name}\n")
        for key, inner in value.items():
            show(inner, key, depth + bool(name))
    elif isinstance(value, tuple):
        sys.stdout.write(f"{pad}{name}: {' .. '.join(f'{part:.3f}' for part in value)}\n")
    else:
        sys.stdout.write(f"{pad}{name}: {f'{value:.3f}' if isinstance(value, float) else value}\n")


def main(argv: list[str]) -> int:
    """Parse the arguments, measure, print."""
    parser = argparse.ArgumentParser(prog="scripts/bench fidelity", description=__doc__)
    parser.add_argument("--world", choices=sorted(WORLDS), default="kinematic")
    parser.add_argument("--half", choices=HALVES, default="report", help="fit: for tuning; report: kept for the result")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    result = measure(options.world, options.half, options.seeds, options.workers)
    if options.json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        show(result)
    return 0
