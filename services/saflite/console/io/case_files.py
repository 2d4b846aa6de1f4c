"""Test cases as files: our JSON always, competition YAML where it can say everything."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import msgspec

from saflite.console.io import outputs
from saflite.contract.test_case import TestCase, identity, twin_text


def one_line(case: TestCase) -> str:
    """Return a test case in short: its boxes, its stimuli."""
    boxes = [
        f"{box.length_m:g}x{box.width_m:g}x{box.height_m:g}@({box.x_m:.1f},{box.y_m:.1f}) {box.rotation_deg:.0f}deg"
        for box in case.scenario.obstacles
    ]
    stimuli = [
        f"{one.at_s:g}s {one.kind} {one.name} {' '.join(f'{value:g}' for value in one.values)}".rstrip()
        for one in case.stimuli
    ]
    twin = [twin_text(case.twin)] if case.twin else []
    return "; ".join(twin + boxes + stimuli) or "nothing in the way"


def write_cases(cases: Iterable[TestCase], folder: Path, *, force: bool = False) -> list[Path]:
    """Write one `.json` per test case, named by its identity; returns the paths. See `outputs.write`."""
    files = {folder / f"{identity(case)}.json": case for case in cases}
    for path, case in files.items():
        outputs.write(path, msgspec.json.format(msgspec.json.encode(case)) + b"\n", force=force)
    return list(files)
