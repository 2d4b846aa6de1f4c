"""The violations as one CSV table: policy, standing, robustness, fingerprint, the boxes or stimuli, features.

A row of a smallest form names in `smallest_form_of` the test case it was made of: count those where that is empty.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

from saflite.contract.plain import cell
from saflite.contract.test_case import TestCase, told_in_order
from saflite.recorder.files import write_file
from saflite.recorder.summary import Finding, RunSummary

FILE = "violations.csv"
COLUMNS = (
    *("test_case", "policy", "confirmation", "severity", "robustness", "fingerprint", "reflown", "failed_again"),
    *("rate_low", "rate_high", "again_low", "again_high", "hard_again", "strategy", "round", "parent"),
    *("min_distance_m", "duration_s", "inputs", "recording", "smallest_form_of"),
)


def export(summary: RunSummary, folder: Path) -> tuple[Path, ...]:
    """Write `violations.csv` into `folder`; returns the file written."""
    path = folder / FILE
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(map(cell, _row(finding)) for finding in summary.findings)
    write_file(path, text.getvalue())
    return (path,)


def _row(finding: Finding) -> tuple[object, ...]:
    violation, origin = finding.violation, finding.test_case.origin
    features = finding.judgement.features if finding.judgement is not None else {}
    return (
        *(violation.test_case, violation.policy, violation.confirmation, violation.severity, violation.robustness),
        *(violation.fingerprint, violation.reflown, violation.failed_again),
        *(violation.rate_low, violation.rate_high, violation.again_low, violation.again_high, violation.hard_again),
        *(origin.strategy, origin.round, origin.parent),
        *(features.get("min_distance_m", ""), features.get("duration_s", "")),
        *(_inputs(finding.test_case), finding.recording, finding.smallest_form_of),
    )


def _inputs(test_case: TestCase) -> str:
    boxes = (
        f"box {box.length_m:g}x{box.width_m:g}x{box.height_m:g} at ({box.x_m:g}, {box.y_m:g}) "
        f"turned {box.rotation_deg:g}"
        for box in test_case.scenario.obstacles
    )
    return "; ".join(filter(None, (*boxes, told_in_order(test_case.stimuli))))
