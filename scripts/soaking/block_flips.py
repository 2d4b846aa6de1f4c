"""Damages the books of the run that the soak has made, block by block in copies: is each damage told, or harmless?"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "unit" / "campaign"))

import books_corruption


def corruptions(run_dir: Path, count: int, rng: np.random.Generator) -> dict[str, int]:
    """Return what came of `count` flipped or cut blocks of a run that nobody works on, drawn at random."""
    found = Counter({"told": 0, "harmless": 0, "silent": 0})
    if count <= 0:
        return dict(found)
    every = list(books_corruption.faults(run_dir))
    with tempfile.TemporaryDirectory() as folder:
        whole = books_corruption.whole_of(run_dir, Path(folder) / "whole")
        for place in rng.permutation(len(every))[:count]:
            fault = every[int(place)]
            outcome = books_corruption.outcome_of(fault, run_dir, Path(folder) / "damaged", whole)
            found[outcome] += 1
            if outcome == "silent":
                print(f"silent: {fault}", file=sys.stderr)
    return dict(found)
