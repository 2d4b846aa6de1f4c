"""Bar pictures: the evaluations as whole SVG files, reliability as an element of the report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from saflite.console.view.report.style import CSS
from saflite.console.view.report.svg import label, tag
from saflite.contract.score import DULL_BELOW, INTERESTING_ABOVE

if TYPE_CHECKING:
    from saflite.console.evaluation.bugs import BugResult
    from saflite.contract.score import Band
    from saflite.scorer_pool.calibration import Calibration

WIDTH_PX, ROW_PX, LEFT_PX, RIGHT_PX, TOP_PX = 760.0, 26.0, 170.0, 90.0, 34.0
GRAPH_WIDTH_PX, GRAPH_HEIGHT_PX, GRAPH_LEFT_PX, GRAPH_TOP_PX, GRAPH_BOTTOM_PX = 420.0, 170.0, 40.0, 26.0, 30.0
_COLOURS: dict[Band, str] = {"interesting": "#cf2f3a", "middling": "#e2a93b", "dull": "#8a93a3"}


def bugs(results: Sequence[BugResult]) -> str:
    """Return one bar per bug: the share of inputs in each band, a mark where the trigger stands by rank."""
    parts = [label(LEFT_PX, 16, "inputs by band, most interesting first; the mark is the trigger's rank", "title")]
    span = WIDTH_PX - LEFT_PX - RIGHT_PX
    parts += _bands_named(16.0 + ROW_PX)
    for row, one in enumerate(results):
        y, x = TOP_PX + (row + 1) * ROW_PX, LEFT_PX
        parts.append(label(LEFT_PX - 8, y + 15, f"{one.bug} {one.policy}", "", "end"))
        for name, colour in _COLOURS.items():
            width = span * one.bands[name] / 100.0
            parts.append(tag("rect", x=x, y=y + 3, width=width, height=ROW_PX - 8, fill=colour))
            x += width
        place = LEFT_PX + span * (one.trigger_rank - 0.5) / one.inputs
        parts.append(tag("line", x1=place, y1=y, x2=place, y2=y + ROW_PX - 2, stroke="#1c2330", stroke_width=3.0))
        parts.append(label(WIDTH_PX - RIGHT_PX + 8, y + 15, f"{one.trigger_rank:g} of {one.inputs}"))
    return _file(parts, len(results) + 1)


def _bands_named(y: float) -> list[str]:
    """Return what the colours mean, side by side."""
    words = {
        "interesting": f"score above {INTERESTING_ABOVE:g}",
        "middling": "between",
        "dull": f"below {DULL_BELOW:g}",
    }
    parts = []
    for place, (name, colour) in enumerate(_COLOURS.items()):
        x = LEFT_PX + 175.0 * place
        parts.append(tag("rect", x=x, y=y - 9, width=10.0, height=10.0, fill=colour))
        parts.append(label(x + 15, y, f"{name} ({words[name]})", "tick"))
    return parts


def reliability(one: Calibration) -> str:
    """Return the reliability curve of a model as columns: the share that violated per band of scores, with intervals.

    A dashed line marks the share a score promises if it is read as ten times the chance of a violation.
    """
    parts = [label(0, 13, f"{one.model}: share violated, by score", "title")]
    span, width = GRAPH_HEIGHT_PX - GRAPH_TOP_PX - GRAPH_BOTTOM_PX, (GRAPH_WIDTH_PX - GRAPH_LEFT_PX) / 5.0
    foot = GRAPH_HEIGHT_PX - GRAPH_BOTTOM_PX
    for share in (0.0, 0.5, 1.0):
        y = foot - span * share
        parts.append(tag("line", x1=GRAPH_LEFT_PX, y1=y, x2=GRAPH_WIDTH_PX, y2=y, class_="grid"))
        parts.append(label(GRAPH_LEFT_PX - 5, y + 3, f"{share:.0%}", "tick", "end"))
    for place, step in enumerate(one.reliability):
        x, middle = GRAPH_LEFT_PX + place * width, GRAPH_LEFT_PX + (place + 0.5) * width
        parts.append(label(middle, foot + 12, f"{step.from_score:g} to {step.to_score:g}", "tick", "middle"))
        parts.append(label(middle, foot + 24, f"{step.count} flights", "tick", "middle"))
        found = step.violated
        if found.value is None or found.low is None or found.high is None or step.mean_score is None:
            continue
        height = span * found.value
        parts.append(tag("rect", x=x + 8, y=foot - height, width=width - 16, height=height, fill="var(--blue)"))
        low, high = foot - span * found.low, foot - span * found.high
        parts.append(tag("line", x1=middle, y1=low, x2=middle, y2=high, stroke="var(--ink)", stroke_width=1.5))
        promised = foot - span * step.mean_score / 10.0
        parts.append(tag("line", x1=x + 3, y1=promised, x2=x + width - 3, y2=promised, class_="limit"))
    size = f"0 0 {GRAPH_WIDTH_PX:.0f} {GRAPH_HEIGHT_PX:.0f}"
    return tag("svg", "".join(parts), viewBox=size, class_="chart", role="img")


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
                parts.append(label(LEFT_PX + 4, y + 15, "undefined", "tick"))
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
