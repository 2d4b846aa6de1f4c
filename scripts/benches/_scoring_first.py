"""Part of `scripts/bench scoring`: flights to the first confirmed violation, per embedded model, mission and seed."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from _inline import Flights, Inline

from saflite.campaign.builtin import load_campaign
from saflite.contract.rng import derive

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


def table(
    missions: Sequence[int], seeds: int, models: Sequence[str] = MODELS, tell: bool = True
) -> list[dict[str, object]]:
    """Return one row per mission and model: median, its 95 % bootstrap interval, and the ratio to `random`."""
    rows: list[dict[str, object]] = []
    pooled: dict[str, list[int]] = {model: [] for model in models}
    for mission in missions:
        counts: dict[str, list[int]] = {model: [] for model in models}
        for rng_seed in range(1, seeds + 1):
            flights = Flights()  # what one model flew another need not fly again: same seed, same test case
            for model in models:
                counts[model].append(first_find(model, mission, rng_seed, flights))
            if tell:
                done = {model: values[-1] for model, values in counts.items()}
                sys.stderr.write(f"mission {mission} seed {rng_seed}: {done}\n")
        rows += [_row(f"mission {mission}", model, counts[model], counts.get("random")) for model in models]
        for model in models:
            pooled[model] += counts[model]
    return rows + [_row("all", model, pooled[model], pooled.get("random")) for model in models]


def _row(where: str, model: str, counts: list[int], chance: list[int] | None) -> dict[str, object]:
    rng = derive(1, "first find", where, model)
    values = np.array(counts)
    drawn = rng.integers(0, len(values), (2000, len(values)))
    medians = np.median(values[drawn], axis=1)
    row: dict[str, object] = {
        "where": where,
        "model": model,
        "campaigns": len(values),
        "median": float(np.median(values)),
        "low": float(np.quantile(medians, 0.025)),
        "high": float(np.quantile(medians, 0.975)),
        "none_in_100": int((values > FLIGHTS_MAX).sum()),
    }
    if chance is not None:
        others = np.array(chance)
        ratios = medians / np.median(others[drawn], axis=1)  # the same campaigns are drawn for both
        row |= {
            "ratio_to_random": float(np.median(values) / np.median(others)),
            "ratio_low": float(np.quantile(ratios, 0.025)),
            "ratio_high": float(np.quantile(ratios, 0.975)),
        }
    return row
