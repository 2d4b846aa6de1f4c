"""Part of `scripts/bench scoring`: flights to the first confirmed violation, per embedded model, mission and seed."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import msgspec
import numpy as np
from _bootstrap import bootstrap_95
from _inline import Flights, Inline
from numpy.typing import NDArray

from saflite.campaign.presets.campaigns import load_campaign
from saflite.contract.rng import derive
from saflite.contract.test_case import TestCase, identity
from saflite.flight.planner.kinematic import KinematicFlight
from saflite.scorer_pool.models import low_fidelity

MODELS = ("random", "constant", "novelty", "gap", "low_fidelity", "blend", "surrogate", "ensemble")
FLIGHTS_MAX = 100
SHARED_MEMORY = Path("/dev/shm")


def first_find(model: str, mission: int, rng_seed: int, flights: Flights) -> int:
    """Return the flights flown, confirmations included, when the first violation was confirmed; 101 if none was."""
    base = load_campaign(f"avoidance-m{mission}")
    scorer = msgspec.structs.replace(base.scorer, model=model)
    campaign = msgspec.structs.replace(
        base, budget_flights=FLIGHTS_MAX, rng_seed=rng_seed, record="none", scorer=scorer
    )
    folder = Path(tempfile.mkdtemp(dir=SHARED_MEMORY if SHARED_MEMORY.exists() else None))
    run = Inline(campaign, folder / "run", flights)
    try:
        status = run.run(lambda status: status.violations_confirmed >= 1)
    finally:
        run.close()
        shutil.rmtree(folder, ignore_errors=True)
    return status.flights if status.violations_confirmed else FLIGHTS_MAX + 1


def first_finds(mission: int, rng_seed: int, models: Sequence[str]) -> dict[str, int]:
    """Return the first find of each model from one seed; what one flew, really or cheaply, another need not again."""
    kept: dict[tuple[str, int], KinematicFlight] = {}
    fly = low_fidelity._fly

    def remembered(test_case: TestCase, number: int) -> KinematicFlight:
        key = (identity(test_case), number)
        if key not in kept:
            kept[key] = fly(test_case, number)
        return kept[key]

    low_fidelity._fly = remembered
    try:
        flights = Flights()
        found = {model: first_find(model, mission, rng_seed, flights) for model in models}
    finally:
        low_fidelity._fly = fly
    sys.stderr.write(f"mission {mission} seed {rng_seed}: {found}\n")
    return found


def table(
    missions: Sequence[int], seeds: int, models: Sequence[str], jobs: int, out: Path | None = None
) -> list[dict[str, object]]:
    """Return one row per mission and model: median, its 95 % bootstrap interval, and the ratio to `random`.

    Campaigns are noted in `out` as they end, one JSON line each; those noted there already are not run again.
    """
    rows: list[dict[str, object]] = []
    pooled: dict[str, list[int]] = {model: [] for model in models}
    every = _noted(out, models)
    places = [(mission, rng_seed) for rng_seed in range(1, seeds + 1) for mission in missions]
    with ProcessPoolExecutor(jobs) as processes:
        left = {processes.submit(first_finds, *place, tuple(models)): place for place in places if place not in every}
        for done in as_completed(left):
            every[left[done]] = done.result()
            if out is not None:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([*left[done], every[left[done]]]) + "\n")
    for mission in missions:
        here = [every[place] for place in places if place[0] == mission]
        counts = {model: [found[model] for found in here] for model in models}
        rows += [_row(f"mission {mission}", model, counts[model], counts.get("random")) for model in models]
        for model in models:
            pooled[model] += counts[model]
    return rows + [_row("all", model, pooled[model], pooled.get("random")) for model in models]


def _noted(out: Path | None, models: Sequence[str]) -> dict[tuple[int, int], dict[str, int]]:
    """Return the campaigns of an earlier run that had all the models, by mission and seed."""
    if out is None or not out.exists():
        return {}
    rows = [json.loads(line) for line in out.read_text(encoding="utf-8").splitlines()]
    return {(mission, rng_seed): found for mission, rng_seed, found in rows if found.keys() >= set(models)}


def _row(where: str, model: str, counts: list[int], chance: list[int] | None) -> dict[str, object]:
    values = np.array(counts)
    low, high = bootstrap_95(
        lambda index: float(np.median(values[index])), len(values), derive(1, "first find", where, model)
    )
    row: dict[str, object] = {
        "where": where,
        "model": model,
        "campaigns": len(values),
        "median": float(np.median(values)),
        "low": low,
        "high": high,
        "none_in_100": int((values > FLIGHTS_MAX).sum()),
    }
    if chance is not None:
        others = np.array(chance)

        def ratio(index: NDArray[np.intp]) -> float:  # the same campaigns are drawn for both
            return float(np.median(values[index]) / np.median(others[index]))

        low, high = bootstrap_95(ratio, len(values), derive(1, "first find", where, model))
        row |= {"ratio_to_random": ratio(np.arange(len(values))), "ratio_low": low, "ratio_high": high}
    return row
