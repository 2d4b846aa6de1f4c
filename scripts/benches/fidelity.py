"""How faithful the avoidance flights are: free-flight times, simulated layouts, real flights.

Protocol: fit on one half of the layouts (split by hash), report the other. Simulated layouts (mission 2, unique
layouts, median of the seeds, 500 s): area under the ROC curve and rank correlation of simulation, of the gap between
the boxes, and of both, with bootstrap intervals over layouts. Real flights: same route, deviation, clearance of the
boxes other than the nearest, duration, correlation of the distance inside each tool; never a pooled area, which would
only tell the tools apart. Every simulation is a row (`--rows FILE`); the figures are worked out
from rows alone (`--read FILE`).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
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
from _fidelity_worlds import WORLDS, World
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


class Row(msgspec.Struct, omit_defaults=True):
    """One simulation: of a published layout, or of a real flight laid over its track (the last three fields)."""

    world: str
    half: str
    of: str
    rng_seed: int
    min_distance_m: float
    duration_s: float
    deviation_m: float = 0.0
    same_route: bool = False
    clearances_m: list[float] = []


def fly_layout(layout: Layout, world: str, seeds: int) -> list[Row]:
    """Fly a published layout with every seed."""
    flown = [WORLDS[world]()("mission2", layout.obstacles, seed, LIMIT_S) for seed in range(seeds)]
    return [
        Row(world, layout.half, layout.name, seed, round(one.min_distance_m, 4), round(one.duration_s, 2))
        for seed, one in enumerate(flown)
    ]


def fly_again(flight: RealFlight, world: str, seeds: int) -> list[Row]:
    """Fly a real flight's layout with every seed and lay the tracks over the real one."""
    rows = []
    for seed in range(seeds):
        one = WORLDS[world]()(flight.mission, flight.obstacles, seed, REAL_LIMIT_S)
        apart = off_route(flight.track[:, 1:], one.track)
        rows.append(
            Row(
                world,
                flight.half,
                flight.name,
                seed,
                round(one.min_distance_m, 4),
                round(one.duration_s, 2),
                round(float(np.median(apart)), 4),
                same_route(apart),
                [round(float(each), 4) for each in clearances(one.track, flight.boxes)],
            )
        )
    return rows


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


def compare(flight: RealFlight, rows: list[Row]) -> Compared:
    """Compare a real flight with the medians of its simulations."""
    real_m = clearances(flight.track[:, 1:], flight.boxes)
    flown_m = np.median([row.clearances_m for row in rows], axis=0)
    others = [i for i in range(len(real_m)) if i != int(np.argmin(real_m))]
    return Compared(
        deviation_m=float(np.median([row.deviation_m for row in rows])),
        route_share=float(np.mean([row.same_route for row in rows])),
        real_others_m=[float(real_m[i]) for i in others],
        flown_others_m=[float(flown_m[i]) for i in others],
        duration_s=float(np.median([row.duration_s for row in rows])),
        min_distance_m=float(np.median([row.min_distance_m for row in rows])),
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


def fly(world: str, half: str, seeds: int, workers: int) -> list[Row]:
    """Fly every layout and every real flight's boxes of a half."""
    shapes = [layout for layout in layouts() if half in ("all", layout.half)]
    flights = [flight for flight in real_flights() if half in ("all", flight.half)]
    with ProcessPoolExecutor(workers) as pool:
        flown = [
            *pool.map(partial(fly_layout, world=world, seeds=seeds), shapes),
            *pool.map(partial(fly_again, world=world, seeds=seeds), flights),
        ]
    return [row for rows in flown for row in rows]


def read_rows(path: Path, world: str, half: str) -> list[Row] | str:
    """Return the rows of a world and half, or what is wrong with the file."""
    try:
        read = msgspec.json.Decoder(Row).decode_lines(path.read_bytes())
    except (OSError, msgspec.MsgspecError) as error:
        return f"not rows that --rows writes: {error}"
    rows = [row for row in read if row.world == world and half in ("all", row.half)]
    return rows or f"no rows of --world {world} --half {half}; fly them with --rows"


def by_seed(chosen: list[Layout], rows: dict[str, list[Row]]) -> dict[str, tuple[float, ...]]:
    """Return area and rank correlation of the simulated layouts with each seed alone, sorted."""
    real_m = np.array([layout.min_distance_m for layout in chosen])
    areas, ranks = [], []
    for seed in range(min(len(rows[layout.name]) for layout in chosen)):
        flown_m = np.array([rows[layout.name][seed].min_distance_m for layout in chosen])
        area = roc_area(real_m < SAFE_M, -flown_m)
        areas.append(float("nan") if area is None else area)
        ranks.append(rank_correlation(real_m, flown_m))
    return {"area": tuple(sorted(areas)), "rank_correlation": tuple(sorted(ranks))}


def judge(found: list[Row]) -> dict[str, object]:
    """Return the protocol's numbers of one world and half from its rows."""
    rows: dict[str, list[Row]] = defaultdict(list)
    for row in sorted(found, key=lambda row: row.rng_seed):
        rows[row.of].append(row)
    shapes = [layout for layout in layouts() if layout.name in rows]
    flights = [flight for flight in real_flights() if flight.name in rows]
    flown_m = np.array([np.median([row.min_distance_m for row in rows[layout.name]]) for layout in shapes])
    return {
        "world": found[0].world,
        "half": found[0].half if len({row.half for row in found}) == 1 else "all",
        "seeds": max(row.rng_seed for row in found) + 1,
        "simulated_layouts": judge_layouts(shapes, flown_m),
        "simulated_layouts_with_each_seed_alone": by_seed(shapes, rows),
        "real_flights": judge_flights(flights, [compare(flight, rows[flight.name]) for flight in flights]),
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
    parser.add_argument("--rows", type=Path, help="write every simulation to this file, one a line")
    parser.add_argument("--read", type=Path, help="fly nothing: work the figures out from such a file")
    options = parser.parse_args(argv)
    began = time.perf_counter()
    if options.read:
        rows = read_rows(options.read, options.world, options.half)
        if isinstance(rows, str):
            sys.stderr.write(f"fidelity: {options.read}: {rows}\n")
            return 2
        result = judge(rows)
    else:
        rows = fly(options.world, options.half, options.seeds, options.workers)
        flown = {"free_flight": free_flight(WORLDS[options.world]()), "wall_s": time.perf_counter() - began}
        result = {**judge(rows), **flown}
    if options.rows:
        options.rows.write_bytes(msgspec.json.Encoder().encode_lines(rows))
    if options.json:
        sys.stdout.write(json.dumps(result) + "\n")
    else:
        show(result)
    return 0
