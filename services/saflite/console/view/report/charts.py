"""Line charts as SVG: one or more curves over one axis, with levels to compare them to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saflite.console.view.report.svg import label, nice_step, points, tag

WIDTH_PX, HEIGHT_PX = 560.0, 202.0
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 46.0, 10.0, 22.0, 38.0
POINTS_MAX = 500
CHAR_PX, ROW_PX, ROWS_MAX = 5.6, 11.0, 6
"""Width of a letter of a tick's text, about; height of a row of names, and how many there may be."""
NAME_PX, NAME_PLACES, NAME_SAMPLES = 10.0, 9, 24
"""Height of a level's name; places along the line that are tried for it; samples of the curves over its width."""


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
    parts = [label(LEFT_PX, 13, title, "title")]
    parts += _marks(frame, marks)
    parts += _axes(frame, x_name, 1.0 if counts else 0.0)
    for level in levels:
        y = frame.y(level.y)
        parts.append(tag("line", x1=LEFT_PX, y1=y, x2=WIDTH_PX - RIGHT_PX, y2=y, class_=level.css))
    drawn = [_places(frame, curve) for curve in curves]
    parts += [
        tag("polyline", points=points(places.tolist()), class_=f"curve {curve.css}")
        for curve, places in zip(curves, drawn, strict=True)
    ]
    parts += [_level_name(frame, level, drawn) for level in levels]
    parts.append(_legend([curve for curve in curves if curve.name]))
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
    step = nice_step(frame.x_high - frame.x_low, 7)
    for number in range(math.ceil(frame.x_low / step), math.floor(frame.x_high / step) + 1):
        parts.append(label(frame.x(number * step), HEIGHT_PX - 26, f"{number * step:g}", "tick", "middle"))
    parts.append(label(WIDTH_PX - RIGHT_PX, HEIGHT_PX - 15, x_name, "tick", "end"))
    return parts


def _marks(frame: _Frame, marks: Sequence[Mark]) -> list[str]:
    """Return bands and lines with their names, each name in the first row where it is over no other.

    A name that fits in no row is left out; the line shows it when it is pointed at.
    """
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
        if mark.name and row is not None:
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


def _level_name(frame: _Frame, level: Level, drawn: Sequence[NDArray[np.float64]]) -> str:
    """Return the name of a level beside its line, where the least of the curves runs under it; right first."""
    line, width = frame.y(level.y), CHAR_PX * len(level.name)
    lefts = np.linspace(WIDTH_PX - RIGHT_PX - 2 - width, LEFT_PX + 2, NAME_PLACES)
    feet = [foot for foot in (line - 3, line + NAME_PX) if TOP_PX + NAME_PX <= foot <= HEIGHT_PX - BOTTOM_PX]
    along = np.linspace(0.0, 1.0, NAME_SAMPLES)

    def covered(left: float, foot: float) -> int:
        """Count the places along the name at which a curve passes through it."""
        found = 0
        for places in drawn:
            if len(places) > 0:
                ys = np.interp(left + along * width, places[:, 0], places[:, 1], left=np.inf, right=np.inf)
                found += int(np.count_nonzero((ys > foot - NAME_PX) & (ys < foot + 2)))
        return found

    choices = [
        (covered(float(left), foot), number, float(left), foot) for number, left in enumerate(lefts) for foot in feet
    ]
    _, _, left, foot = min(choices, key=lambda one: one[:2], default=(0, 0, float(lefts[0]), line - 3))
    return label(left, foot, level.name, "tick name")


def _thinned(ys: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices to draw: of each stretch its least and greatest value, so that no peak is lost."""
    if len(ys) <= POINTS_MAX:
        return np.arange(len(ys))
    keep = {0, len(ys) - 1}
    for part in np.array_split(np.arange(len(ys)), POINTS_MAX // 2):
        values = np.where(np.isfinite(ys[part]), ys[part], 0.0)
        keep |= {int(part[values.argmin()]), int(part[values.argmax()])}
    return np.array(sorted(keep), dtype=np.intp)


def _legend(curves: Sequence[Curve]) -> str:
    """Return the names of the curves, on the last row of the chart."""
    parts, x, y = [], LEFT_PX, HEIGHT_PX - 3
    for curve in curves:
        parts.append(tag("line", x1=x, y1=y - 4, x2=x + 14, y2=y - 4, class_=f"curve {curve.css}"))
        parts.append(label(x + 18, y, curve.name, "tick"))
        x += 18 + CHAR_PX * len(curve.name) + 16
    return "".join(parts)
