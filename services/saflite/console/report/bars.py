"""Bar pictures of the evaluations, as whole SVG files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from saflite.console.report.style import CSS
from saflite.console.report.svg import label, tag

if TYPE_CHECKING:
    from saflite.contract.score import Band
    from saflite.scorer_pool.calibration import Calibration
    from saflite.scorer_pool.evaluate_bugs import BugResult

WIDTH_PX, ROW_PX, LEFT_PX, RIGHT_PX, TOP_PX = 760.0, 26.0, 170.0, 90.0, 34.0
_COLOURS: dict[Band, str] = {"interesting": "#cf2f3a", "middling": "#e2a93b", "dull": "#8a93a3"}


def bugs(results: Sequence[BugResult]) -> str:
    """Return one bar per bug: the share of inputs in each band, a mark where the trigger stands by rank."""
    parts = [label(LEFT_PX, 16, "inputs by band, most interesting first; the mark is the trigger's rank", "title")]
    span = WIDTH_PX - LEFT_PX - RIGHT_PX
    for row, one in enumerate(results):
        y, x = TOP_PX + row * ROW_PX, LEFT_PX
        parts.append(label(LEFT_PX - 8, y + 15, f"{one.bug} {one.policy}", "", "end"))
        for name, colour in _COLOURS.items():
            width = span * one.bands[name] / 100.0
            parts.append(tag("rect", x=x, y=y + 3, width=width, height=ROW_PX - 8, fill=colour))
            x += width
        place = LEFT_PX + span * (one.trigger_rank - 0.5) / one.inputs
        parts.append(tag("line", x1=place, y1=y, x2=place, y2=y + ROW_PX - 2, stroke="#1c2330", stroke_width=3.0))
        parts.append(label(WIDTH_PX - RIGHT_PX + 8, y + 15, f"{one.trigger_rank:g} of {one.inputs}"))
    return _file(parts, len(results))


def calibrations(found: Sequence[Calibration]) -> str:
    """Return bars of accuracy, precision, recall and F1 with their intervals, per answerer."""
    parts = [label(LEFT_PX, 16, "how well the answers met the labels, 95 % intervals", "title")]
    span, row = WIDTH_PX - LEFT_PX - RIGHT_PX, 0
    for one in found:
        metrics = one.metrics
        named = (
            ("accuracy", metrics.accuracy),
            ("precision", metrics.precision),
            ("recall", metrics.recall),
            ("F1", metrics.f1),
        )
        for name, figure in named:
            y = TOP_PX + row * ROW_PX
            row += 1
            parts.append(label(LEFT_PX - 8, y + 15, f"{one.model} {name}", "", "end"))
            if figure.value is None or figure.low is None or figure.high is None:
                parts.append(label(LEFT_PX + 4, y + 15, "cannot be said", "tick"))
                continue
            parts.append(tag("rect", x=LEFT_PX, y=y + 5, width=span * figure.value, height=ROW_PX - 12, fill="#2563c9"))
            low, high = LEFT_PX + span * figure.low, LEFT_PX + span * figure.high
            parts.append(tag("line", x1=low, y1=y + 12, x2=high, y2=y + 12, stroke="#1c2330", stroke_width=2.0))
            parts.append(label(WIDTH_PX - RIGHT_PX + 8, y + 15, f"{figure.value:.2f}"))
    return _file(parts, row)


def _file(parts: Sequence[str], rows: int) -> str:
    height = TOP_PX + rows * ROW_PX + 10
    ground = tag("rect", x=0, y=0, width=WIDTH_PX, height=height, fill="var(--panel)")
    content = f"<style>{CSS}</style>{ground}{''.join(parts)}"
    return tag("svg", content, xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {WIDTH_PX:.0f} {height:.0f}") + "\n"
