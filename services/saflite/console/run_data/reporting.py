"""Writes what a run leaves for people: report, violating test cases, exports."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.campaign.storage.own_folder import check_run_closed
from saflite.console.io import outputs
from saflite.console.run_data.embargo import ALL, Released
from saflite.console.run_data.run_folder import RunFolder, open_run

if TYPE_CHECKING:
    from saflite.console.view.report.data import ReportData

REPORT = "report.html"
TEST_CASES = "test_cases"
STATE = "<!-- of the run as it is since event %d -->\n"
"""Ends a report: whether a run went on since is told by its events, not by clocks, which may be set back."""


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
        check_run_closed(run_dir)
    with open_run(run_dir) as run:
        found, since = data.read(run, released), run.last_change()
    text = page.render(found, str(run_dir)) + STATE % since
    outputs.write(place, text.encode(), force=force or path is None)
    return place, found


def is_reported(run: RunFolder) -> bool:
    """Return whether the run's own report shows it as it is, and not as an earlier sitting left it."""
    state = (STATE % run.last_change()).encode()
    try:
        with (run.path / REPORT).open("rb") as report:
            report.seek(-len(state), os.SEEK_END)
            return report.read() == state
    except OSError:  # there is none, or it is shorter than that
        return False


def write_test_cases(run_dir: Path) -> tuple[Path, ...]:
    """Write the violating test cases, all of them, as competition YAML into the run folder; returns the files."""
    from saflite.recorder.export import export

    with open_run(run_dir) as run:
        return export("yaml", run.summary((ALL,)), run_dir / TEST_CASES)
