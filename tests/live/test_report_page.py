"""The static report in headless Chromium: texts of a chart lie inside it, over no other, and can be read on a phone."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import browser
import msgspec
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "unit" / "console"))

from test_report import data

from saflite.console.view.report import page
from saflite.contract.test_case import Stimulus
from saflite.scorer_pool.calibration import Row, calibrate_all

pytestmark = [pytest.mark.live, pytest.mark.skipif(bool(browser.MISSING), reason=browser.MISSING or "there is one")]
LETTERS_PX_MIN = 8.5
TEXTS = """return [...document.querySelectorAll('svg.chart')].map(chart => {
    const frame = chart.getBoundingClientRect(), scale = frame.width / chart.viewBox.baseVal.width;
    const texts = [...chart.querySelectorAll('text')].map(one => [one.textContent, one.getBoundingClientRect(),
        scale * parseFloat(getComputedStyle(one).fontSize)]);
    const wrong = [];
    texts.forEach(([text, box, size], at) => {
        if (size < arguments[0]) wrong.push(`${text}: ${size} px`);
        if (box.left < frame.left - 1 || box.right > frame.right + 1) wrong.push(`${text}: outside`);
        for (const [other, place] of texts.slice(at + 1)) {
            const wide = Math.min(box.right, place.right) - Math.max(box.left, place.left);
            const high = Math.min(box.bottom, place.bottom) - Math.max(box.top, place.top);
            if (wide > 0.5 && high > 0.3 * box.height) wrong.push(`${text} over ${other}`);
        }
    });
    const panel = chart.closest('figure').getBoundingClientRect();
    if (frame.right > panel.right + 1) wrong.push('wider than its panel');
    return wrong;
})"""

HOLES = """return [...document.querySelectorAll('.violation .pictures')].flatMap(pictures => {
    const below = {};
    for (const figure of pictures.children) {
        const box = figure.getBoundingClientRect(), column = Math.round(box.left);
        (below[column] = below[column] || []).push(box);
    }
    return Object.values(below).flatMap(boxes =>
        boxes.sort((a, b) => a.top - b.top).slice(1).map((box, at) => box.top - boxes[at].bottom));
})"""


@pytest.fixture(scope="module")
def window() -> Iterator[browser.Browser]:
    with browser.browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report with every kind of chart, inputs close together among them."""
    made = data(2)
    plan = tuple(
        Stimulus(at_s=at_s, kind="parameter", name=name, values=(1.0,))
        for at_s, name in ((20.5, "FS_THR_ENABLE"), (21.0, "FENCE_ALT_MAX"), (21.5, "RTL_ALT"), (30.0, "ANGLE_MAX"))
    )
    first = made.exhibits[0]._replace(test_case=msgspec.structs.replace(made.exhibits[0].test_case, stimuli=plan))
    known = calibrate_all([Row("blend", float(place % 10), place % 3 == 0) for place in range(400)])
    text = page.render(made._replace(exhibits=(first, made.exhibits[1]), calibrations=known), "runs/x")
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(("width", "phone"), [(1280, False), (390, True), (360, True)])
def test_texts_of_charts_can_be_read(window: browser.Browser, report: Path, width: int, phone: bool) -> None:
    window.size(width, 800, phone=phone)
    window.open(report.as_uri())
    found = window.run(TEXTS, LETTERS_PX_MIN)
    assert len(found) > 8
    assert [wrong for chart in found for wrong in chart] == []
    assert window.run("return document.documentElement.scrollWidth <= innerWidth"), "nothing sticks out sideways"


def test_pictures_of_a_find_leave_no_hole_between_them(window: browser.Browser, report: Path) -> None:
    window.size(1280, 900)
    window.open(report.as_uri())
    holes = window.run(HOLES)
    assert len(holes) >= 2
    assert max(holes) <= 20
