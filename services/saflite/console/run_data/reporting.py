"""Writes what a run leaves for people: report, violating test cases, exports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from saflite.campaign.storage.own_folder import check_closed
from saflite.console.io import outputs
from saflite.console.run_data.embargo import ALL, Released
from saflite.console.run_data.run_folder import open_run

if TYPE_CHECKING:
    from saflite.console.view.report.data import ReportData

REPORT = "report.html"
TEST_CASES = "test_cases"


def write(
    run_dir: Path, path: Path | None = None, *, force: bool = False, released: Released = ()
) -> tuple[Path, ReportData]:
    """Write the report; returns where, and what it shows. The run's own is always made anew.

    Findings of memory safety that are not among the `released` fingerprints are only counted in it.

    Raises:
        Refused: no run stands there, its store is damaged, or the report is to stand in the folder of somebody else.
        Unavailable: the file cannot be written.
    """
    from saflite.console.view.report import data, page

    place = path or run_dir / REPORT
    if path is None and run_dir.is_dir():
        check_closed(run_dir)
    with open_run(run_dir) as run:
        found = data.read(run, released)
    text = page.render(found, str(run_dir))
    outputs.write(place, text.encode(), force=force or path is None)
    return place, found


def write_test_cases(run_dir: Path) -> tuple[Path, ...]:
    """Write the violating test cases, all of them, as competition YAML into the run folder; returns the files."""
    from saflite.recorder.export import export

    with open_run(run_dir) as run:
        return export("yaml", run.summary((ALL,)), run_dir / TEST_CASES)
