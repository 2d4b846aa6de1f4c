"""One find in the browser: its evidence, beside the last flight before it that kept the rule."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saflite.console.run_data.run_folder import RunFolder
from saflite.console.view.html_text import escape
from saflite.console.view.report import charts, data, evidence, layout
from saflite.contract.errors import Refused
from saflite.contract.test_case import TestCase, stimulus_text
from saflite.contract.verdict import Judgement, Violation, failed_again
from saflite.recorder.summary import Finding


def in_words(violation: Violation) -> str:
    """Return a find without pictures."""
    rows = (
        ("behaviour", violation.behaviour),
        ("robustness", f"{violation.robustness:+.3f} ({violation.severity})"),
        ("flown again", failed_again(violation)),
        ("test case", violation.test_case),
        ("message", violation.message),
    )
    facts = "".join(f"<tr><th>{key}</th><td>{escape(text)}</td></tr>" for key, text in rows)
    return (
        f'<section class="violation"><h3>{escape(violation.policy)}</h3><table class="facts">{facts}</table></section>'
    )


def shown(run: RunFolder, test_case: str, run_name: str) -> str:
    """Return the evidence of a find and the comparison with a good flight; raises Refused if there is no such find."""
    violation = next((one for one in run.violations() if one.test_case == test_case), None)
    if violation is None:
        raise Refused("test case", where=run_name, expected="one of a find", got=repr(test_case))
    finding = run.finding(violation)
    forms = (name for name in run.smallest_forms() if run.test_case(name).origin.parent == test_case)
    exhibit = data.exhibit(run, finding, run.flights(test_case), next(forms, ""))
    return evidence.section(0, exhibit, run_name) + _beside(run, finding)


def _beside(run: RunFolder, finding: Finding) -> str:
    name = run.good_before(finding.violation.test_case, finding.test_case.origin.parent)
    good = run.judgement(name) if name else None
    if good is None or finding.judgement is None:
        return '<p class="muted">No flight before it kept every rule: nothing to compare with.</p>'
    case = run.test_case(name)
    relation = "its parent" if name == finding.test_case.origin.parent else "the last good flight before it"
    pictures = (
        _figure(f"good: {name}, {relation}", case, good),
        _figure(f"violates: {finding.violation.test_case}", finding.test_case, finding.judgement),
    )
    return (
        f'<section class="violation beside"><h3>Beside {relation}</h3><div class="pictures">{"".join(pictures)}</div>'
        f'<div class="pictures curves">{_overlaid(good, finding.judgement)}</div></section>'
    )


def _track(judgement: Judgement) -> NDArray[np.float64]:
    """Return (t, x, y, z) about once a second, shape (n, 4)."""
    return np.array([tuple(row) for row in judgement.track], dtype=float).reshape(-1, 4)


def _figure(title: str, case: TestCase, judgement: Judgement) -> str:
    inputs = "".join(f"<li>{one.at_s:g} s {escape(stimulus_text(one))}</li>" for one in case.stimuli)
    inputs = inputs or f"<li>{len(case.scenario.obstacles)} boxes</li>"
    drawn = layout.picture(case, _track(judgement)[:, 1:])
    return f"<figure><b>{escape(title)}</b>{drawn}<ul class='muted inputs'>{inputs}</ul></figure>"


def _overlaid(good: Judgement, bad: Judgement) -> str:
    tracks = (("good", "curve1", _track(good)), ("violates", "curve3", _track(bad)))
    height = [charts.Curve(track[:, 0], track[:, 3], css, name) for name, css, track in tracks if len(track)]
    speed = []
    for name, css, track in tracks:
        if len(track) > 1:
            steps = np.diff(track, axis=0)
            metres = np.hypot(steps[:, 1], steps[:, 2])
            speed.append(charts.Curve(track[1:, 0], metres / np.maximum(steps[:, 0], 1e-9), css, name))
    drawn = [
        charts.chart(title, curves, x_name="s")
        for title, curves in (("height of both [m]", height), ("ground speed of both [m/s]", speed))
        if curves
    ]
    return "".join(f"<figure>{one}</figure>" for one in drawn)
