"""The missions of the violations as QGroundControl `.plan` files, way-points and all that a plan may hold kept."""

from __future__ import annotations

from pathlib import Path

from saflite.flight.mission import dump_plan
from saflite.recorder.files import write_file
from saflite.recorder.summary import RunSummary


def export(summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write every different mission once into `folder`; returns the files written."""
    missions = {
        finding.test_case.scenario.mission.name: finding.test_case.scenario.mission
        for finding in summary.findings
        if finding.test_case.scenario.mission is not None
    }
    written = []
    for name, mission in sorted(missions.items()):
        path = folder / f"{name}.plan"
        write_file(path, dump_plan(mission))
        written.append(path)
    return tuple(written)
