"""Writes what a run leaves for people: report, violating test cases, exports."""

from __future__ import annotations

from pathlib import Path

from saflite.console.run_data.run_folder import open_run
from saflite.contract.errors import Unavailable

REPORT = "report.html"
TEST_CASES = "test_cases"


def write(run_dir: Path, path: Path | None = None) -> tuple[Path, int]:
    """Write the report; returns where, and the number of confirmed violations.

    Raises:
        Refused: no run stands there, or its store is damaged.
        Unavailable: the file cannot be written.
    """
    from saflite.console.view.report import data, page

    place = path or run_dir / REPORT
    with open_run(run_dir) as run:
        found = data.read(run)
    text = page.render(found, str(run_dir))
    try:
        place.write_text(text, encoding="utf-8")
    except OSError as fault:
        raise Unavailable(f"the report cannot be written: {fault}") from fault
    return place, sum(1 for exhibit in found.exhibits if exhibit.violation.confirmation == "confirmed")


def write_test_cases(run_dir: Path) -> tuple[Path, ...]:
    """Write the violating test cases as competition YAML into the run folder; returns the files."""
    from saflite.recorder.export import export

    with open_run(run_dir) as run:
        return export("yaml", run.summary(), run_dir / TEST_CASES)
