"""The missions of the violations as QGroundControl `.plan` files, way-points and all that a plan may hold kept."""

from __future__ import annotations

from pathlib import Path

from saflite.recorder.plans import with_readable_rest, write_plan
from saflite.recorder.summary import RunSummary


def export(summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write every different mission once into `folder`; returns the files written."""
    missions = (finding.test_case.scenario.mission for finding in summary.findings)
    readable = (with_readable_rest(mission) for mission in missions if mission is not None)
    return tuple(dict.fromkeys(write_plan(mission, folder) for mission in readable))
