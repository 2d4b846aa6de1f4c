"""Line charts as SVG: one or more curves over one axis, with levels to compare them to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saflite.console.view.html_text import escape
from saflite.console.view.report.svg import label, nice_step, points, tag

WIDTH_PX, HEIGHT_PX = 420.0, 202.0
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 46.0, 12.0, 22.0, 42.0
"""A chart as wide as a phone, nearly: on a wide page it is drawn larger, so that no page has to make letters tiny."""
TICK_ROW_PX, NAME_ROW_PX, LEGEND_ROW_PX = 13.0, 25.0, 38.0
"""Feet of the rows below the axis: its numbers, its name, what the lines are."""
TICKS = 5
POINTS_MAX = 500
CHAR_PX, ROW_PX, ROWS_MAX = 7.2, 12.0, 6
NAMES_MAX = 12  # of marks in one chart that are told beside their lines
"""Width of a letter of a tick's text, at most, as a phone draws it; height of a row of names, and how many may be."""


class Curve(NamedTuple):
    """One curve; `step` draws it as stairs."""

    xs: ArrayLike
    ys: ArrayLike
    css: str = "curve1"
    name: str = ""
    step: bool = False


class Level(NamedTuple):
    """A horizontal line to compare with."""

    y: float
    name: str
    css: str = "level"


class Mark(NamedTuple):
    """A vertical line, or with `until` a band, at a moment."""

    x: float
    name: str = ""
    until: float | None = None
    css: str = "mark"


class _Frame(NamedTuple):
    x_low: float
    x_high: float
    y_low: float
    y_high: float

    def x(self, value: float) -> float:
        return LEFT_PX + (value - self.x_low) / (self.x_high - self.x_low) * (WIDTH_PX - LEFT_PX - RIGHT_PX)

    def y(self, value: float) -> float:
        share = (value - self.y_low) / (self.y_high - self.y_low)
        return HEIGHT_PX - BOTTOM_PX - share * (HEIGHT_PX - TOP_PX - BOTTOM_PX)


def chart(
    title: str,
    curves: Sequence[Curve],
    *,
    x_name: str = "",
    levels: Sequence[Level] = (),
    marks: Sequence[Mark] = (),
    y_max: float | None = None,
    counts: bool = False,
) -> str:
    """Return a chart as an SVG element; `y_max` cuts off what is above, `counts` says that there are whole numbers."""
    frame = _frame(curves, levels, y_max)
    parts = [label(0, 13, title, "title")]
    parts += _marks(frame, marks)
    parts += _axes(frame, x_name, 1.0 if counts else 0.0)
    for level in levels:
        y = frame.y(level.y)
        parts.append(tag("line", x1=LEFT_PX, y1=y, x2=WIDTH_PX - RIGHT_PX, y2=y, class_=level.css))
    parts += [
        tag("polyline", points=points(_places(frame, curve).tolist()), class_=f"curve {curve.css}") for curve in curves
    ]
    named = [(f"curve {curve.css}", curve.name) for curve in curves] + [(level.css, level.name) for level in levels]
    parts.append(_legend([(css, name) for css, name in named if name]))
    return tag("svg", "".join(parts), viewBox=f"0 0 {WIDTH_PX:.0f} {HEIGHT_PX:.0f}", class_="chart", role="img")


def _frame(curves: Sequence[Curve], levels: Sequence[Level], y_max: float | None) -> _Frame:
    xs = [np.asarray(curve.xs, dtype=float) for curve in curves]
    ys = [np.asarray(curve.ys, dtype=float) for curve in curves]
    finite_x = np.concatenate([part[np.isfinite(part)] for part in xs] or [np.zeros(1)])
    finite_y = np.concatenate([part[np.isfinite(part)] for part in ys] + [np.array([level.y for level in levels])])
    if not len(finite_x):
        finite_x = np.zeros(1)
    if not len(finite_y):
        finite_y = np.zeros(1)
    if y_max is not None:
        finite_y = np.minimum(finite_y, y_max)
    x_low, x_high = float(finite_x.min()), float(finite_x.max())
    y_low, y_high = min(0.0, float(finite_y.min())), float(finite_y.max())
    room = 0.06 * (y_high - y_low) or 1.0
    return _Frame(x_low, x_high if x_high > x_low else x_low + 1.0, y_low - (room if y_low < 0 else 0.0), y_high + room)


def _axes(frame: _Frame, x_name: str, y_step_min: float) -> list[str]:
    parts = []
    step = max(y_step_min, nice_step(frame.y_high - frame.y_low, 4))
    for number in range(math.ceil(frame.y_low / step), math.floor(frame.y_high / step) + 1):
        y = frame.y(number * step)
        parts.append(tag("line", x1=LEFT_PX, y1=y, x2=WIDTH_PX - RIGHT_PX, y2=y, class_="grid"))
        parts.append(label(LEFT_PX - 5, y + 3, f"{number * step:g}", "tick", "end"))
    step = nice_step(frame.x_high - frame.x_low, TICKS)
    foot = HEIGHT_PX - BOTTOM_PX
    for number in range(math.ceil(frame.x_low / step), math.floor(frame.x_high / step) + 1):
        parts.append(label(frame.x(number * step), foot + TICK_ROW_PX, f"{number * step:g}", "tick", "middle"))
    parts.append(label(WIDTH_PX - RIGHT_PX, foot + NAME_ROW_PX, x_name, "tick", "end"))
    return parts


def _marks(frame: _Frame, marks: Sequence[Mark]) -> list[str]:
    """Return bands and lines with their names, each name in the first row where it is over no other.

    A name that fits in no row is left out, and so are all where there are many, which would lie over the curve; the
    line shows it when it is pointed at.
    """
    are_few = sum(bool(mark.name) for mark in marks) <= NAMES_MAX
    ends = [LEFT_PX] * ROWS_MAX
    parts = []
    for mark in sorted(marks, key=lambda one: one.x):
        x = frame.x(mark.x)
        height = HEIGHT_PX - BOTTOM_PX - TOP_PX
        if mark.until is not None:
            width = max(2.0, frame.x(mark.until) - x)
            parts.append(tag("rect", x=x, y=TOP_PX, width=width, height=height, class_="band"))
            continue
        title = tag("title", escape(mark.name)) if mark.name else ""
        parts.append(tag("line", title, x1=x, y1=TOP_PX, x2=x, y2=HEIGHT_PX - BOTTOM_PX, class_=mark.css))
        width = CHAR_PX * len(mark.name) + 4
        left = x + 3 if x + 3 + width < WIDTH_PX - RIGHT_PX else x - 3 - width
        row = next((row for row, end in enumerate(ends) if end <= left), None)
        if are_few and mark.name and row is not None:
            ends[row] = left + width
            parts.append(label(left, TOP_PX + 9 + ROW_PX * row, mark.name, "tick name"))
    return parts


def _places(frame: _Frame, curve: Curve) -> NDArray[np.float64]:
    """Return where a curve is drawn in px, shape (points, 2)."""
    xs, ys = np.asarray(curve.xs, dtype=float), np.asarray(curve.ys, dtype=float)
    keep = _thinned(ys)
    xs, ys = xs[keep], np.clip(ys[keep], frame.y_low, frame.y_high)
    if curve.step:
        xs, ys = np.repeat(xs, 2)[1:], np.repeat(ys, 2)[:-1]
    good = np.isfinite(xs) & np.isfinite(ys)
    return np.array([(frame.x(x), frame.y(y)) for x, y in zip(xs[good].tolist(), ys[good].tolist(), strict=True)])


def _thinned(ys: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices to draw: of each stretch its least and greatest value, so that no peak is lost."""
    if len(ys) <= POINTS_MAX:
        return np.arange(len(ys))
    keep = {0, len(ys) - 1}
    for part in np.array_split(np.arange(len(ys)), POINTS_MAX // 2):
        values = np.where(np.isfinite(ys[part]), ys[part], 0.0)
        keep |= {int(part[values.argmin()]), int(part[values.argmax()])}
    return np.array(sorted(keep), dtype=np.intp)


def _legend(lines: Sequence[tuple[str, str]]) -> str:
    """Return what the lines are, each its style and name, on the last row of the chart, where nothing else is."""
    parts, x, y = [], 0.0, HEIGHT_PX - BOTTOM_PX + LEGEND_ROW_PX
    for css, name in lines:
        parts.append(tag("line", x1=x, y1=y - 4, x2=x + 18, y2=y - 4, class_=css))
        parts.append(label(x + 22, y, name, "tick"))
        x += 22 + CHAR_PX * len(name) + 10
    return "".join(parts)
