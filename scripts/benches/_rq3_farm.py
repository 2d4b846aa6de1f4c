"""The campaign of a cell once more in a real farm, with its processes and bus: are the flights the same?"""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

from _rq3_cell import Cell, Memory, campaign_of, run

from saflite.campaign.storage.contents import Contents
from saflite.contract.config import Campaign

FOUND = (0, 1)  # exit codes of a campaign that ran to its end


def compare(cell: Cell) -> int:
    """Run the cell here and in a farm, print both, and return 0 if every flight came as close in both, else 1."""
    here = list(run(cell, Memory()).distances_m)
    with tempfile.TemporaryDirectory(prefix="saflite-rq3-farm-") as folder:
        file, run_dir = Path(folder) / "rq3.toml", Path(folder) / "run"
        file.write_text(toml(campaign_of(cell)), encoding="utf-8")
        command = [sys.executable, "-m", "saflite", "run", str(file), "--out", str(run_dir)]
        ended = subprocess.run(command, check=False, capture_output=True, text=True)
        if ended.returncode not in FOUND:
            sys.stderr.write(f"the farm ended with {ended.returncode}: {ended.stderr}\n")
            return 1
        with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
            outcomes = Contents(database).outcomes(-1, 10**9)
            there = [round(outcome.features.get("min_distance_m", -1.0), 3) for outcome in outcomes]
    print(f"one process: {here}\nfarm:        {there}\n{'equal' if here == there else 'NOT EQUAL'}")
    return int(here != there)


def toml(campaign: Campaign) -> str:
    """Return the campaign as a campaign file."""
    search = campaign.search
    heads = {
        "name": campaign.name,
        "mission": campaign.mission,
        "policies": list(campaign.policies),
        "budget_flights": campaign.budget_flights,
        "rng_seed": campaign.rng_seed,
        "record": campaign.record,
    }
    parts: dict[str, dict[str, object]] = {
        "strategy": {"name": campaign.strategy.name},
        "strategy.settings": dict(campaign.strategy.settings),
        "scorer": {"model": campaign.scorer.model, "batch": campaign.scorer.batch},
        "search": {name: getattr(search, name) for name in search.__struct_fields__},
    }
    lines = [f"{name} = {json.dumps(value)}" for name, value in heads.items()]
    for part, values in parts.items():
        lines += [
            f"[{part}]",
            *(f"{name} = {json.dumps(value)}" for name, value in values.items() if value is not None),
        ]
    return "\n".join(lines) + "\n"
