"""Part `deep` of `scripts/bench scoring`: do real flights come below 0.25 m where cheap flights do?

Random layouts are flown cheaply once; those that came closest and some of those that took long are flown cheaply three
times more, and really under two noises.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from saflite.console.operations import judging
from saflite.contract.test_case import Scenario, Target, TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.geometry import boxes_array
from saflite.flight.mission import builtin_mission, waypoints
from saflite.flight.planner.kinematic import KinematicFlight, fly_kinematic
from saflite.mutator.strategies import random_boxes
from saflite.scorer_pool.geometry_score import look
from saflite.scorer_pool.models.low_fidelity import CLOSE_M, DEEP_M, LATE, MORE, WORTH_FLYING

LAYOUTS, CLOSEST, LATE_ONES, RNG_SEED = 800, 14, 6, 9
POLICY, WALL_LIMIT_S = "min-obstacle-distance", 600.0


class Flown(NamedTuple):
    """Distance (m, to the nearest box), duration (s) and ending of one flight."""

    distance_m: float
    duration_s: float
    ending: str


class Row(NamedTuple):
    """One layout: cheap flights under noise 0 to 3, real ones under noise 0 and 1; boxes (l, w, h, x, y, turn)."""

    mission: int
    cheap: tuple[Flown, ...]
    real: tuple[Flown, ...]
    boxes: tuple[tuple[float, ...], ...]


def fly_all(missions: Sequence[int], out: Path) -> None:
    """Fly the layouts of each mission that has no row in `out` yet, and note them there."""
    known = {row.mission for row in rows_in(out)}
    simulator = judging.OwnSimulator()
    try:
        for mission in missions:
            if mission in known:
                continue
            found = [_row(mission, case, simulator) for case in _chosen(mission)]
            with out.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(row._asdict()) + "\n" for row in found)
    finally:
        simulator.close()


def rows_in(path: Path) -> list[Row]:
    """Return the rows of a file, none if there is none."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    found = [json.loads(line) for line in lines]
    return [
        Row(
            one["mission"],
            tuple(Flown(*flown) for flown in one["cheap"]),
            tuple(Flown(*flown) for flown in one["real"]),
            tuple(map(tuple, one["boxes"])),
        )
        for one in found
    ]


def deep_table(rows: Sequence[Row]) -> list[dict[str, object]]:
    """Return how many real flights came below 0.25 m, by how many of three cheap ones did."""
    flights, deep, late = Counter[str](), Counter[str](), Counter[str]()
    for row in rows:
        near = sum(flown.distance_m < DEEP_M for flown in row.cheap[: 1 + MORE])
        key = f"{near} of {1 + MORE}" if row.cheap[0].distance_m < CLOSE_M else f"first not below {CLOSE_M} m"
        for flown in row.real:
            flights[key] += 1
            deep[key] += flown.distance_m < DEEP_M
            late[key] += flown.distance_m < DEEP_M and row.cheap[0].duration_s > LATE * _alone_s(row.mission)
    return [
        {"cheap": key, "real_flights": flights[key], "below_025": deep[key], "of_those_late": late[key]}
        for key in sorted(flights)
    ]


def _cheap(mission: int, case: TestCase, noise: int) -> KinematicFlight:
    places = waypoints(builtin_mission(f"mission{mission}"))
    points = np.array([(place.x_m, place.y_m, place.z_m) for place in places])
    return fly_kinematic(points, boxes_array(case.scenario.obstacles), rng_seed=noise)


def _alone_s(mission: int) -> float:
    return _cheap(mission, _template(mission), 0).duration_s


def _template(mission: int) -> TestCase:
    return TestCase(target=Target(), scenario=Scenario(mission=builtin_mission(f"mission{mission}")))


def _chosen(mission: int) -> list[TestCase]:
    strategy = random_boxes.Strategy(_template(mission), {}, (), describe())
    drawn = strategy.ask(LAYOUTS, np.random.default_rng(RNG_SEED))
    flown = [(_cheap(mission, case, 0), case) for case in drawn if look(case.scenario).score >= WORTH_FLYING]
    late_s = LATE * _alone_s(mission)
    late = [case for flight, case in flown if flight.duration_s > late_s]
    closest = [case for _, case in sorted(flown, key=lambda one: one[0].min_distance_m)[:CLOSEST]]
    return closest + [case for case in late if case not in closest][:LATE_ONES]


def _row(mission: int, case: TestCase, simulator: judging.OwnSimulator) -> Row:
    cheap = [_cheap(mission, case, noise) for noise in range(2 + MORE)]
    real = []
    for noise in (0, 1):
        flown = simulator.fly(case, WALL_LIMIT_S, noise, noise)
        features = judging.judge(case, flown, (POLICY,), None).features
        distance_m, duration_s = features.get("min_distance_m", -1.0), features.get("duration_s", -1.0)
        real.append(Flown(round(distance_m, 2), round(duration_s), flown.flight.ending))
    boxes = tuple(
        (box.length_m, box.width_m, box.height_m, box.x_m, box.y_m, box.rotation_deg) for box in case.scenario.obstacles
    )
    told = (Flown(round(one.min_distance_m, 2), round(one.duration_s), one.ending) for one in cheap)
    return Row(mission, tuple(told), tuple(real), boxes)
