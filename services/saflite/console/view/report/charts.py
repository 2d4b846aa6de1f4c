"""Line charts as SVG: one or more curves over one axis, with levels to compare them to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saflite.console.view.report.svg import label, nice_step, points, tag

WIDTH_PX, HEIGHT_PX = 560.0, 190.0
LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 46.0, 10.0, 22.0, 26.0
POINTS_MAX = 500


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
) -> str:
    """Return a chart as an SVG element; `y_max` cuts off what is above."""
    frame = _frame(curves, levels, y_max)
    parts = [label(LEFT_PX, 13, title, "title")]
    parts += [_mark(frame, mark, number) for number, mark in enumerate(marks)]
    parts += _axes(frame, x_name)
    for level in levels:
        y = frame.y(level.y)
        parts.append(tag("line", x1=LEFT_PX, y1=y, x2=WIDTH_PX - RIGHT_PX, y2=y, class_=level.css))
        parts.append(label(WIDTH_PX - RIGHT_PX - 2, y - 3, level.name, "tick", "end"))
    parts += [_curve(frame, curve) for curve in curves]
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


def _axes(frame: _Frame, x_name: str) -> list[str]:
    parts = []
    step = nice_step(frame.y_high - frame.y_low, 4)
    for number in range(math.ceil(frame.y_low / step), math.floor(frame.y_high / step) + 1):
        y = frame.y(number * step)
        parts.append(tag("line", x1=LEFT_PX, y1=y, x2=WIDTH_PX - RIGHT_PX, y2=y, class_="grid"))
        parts.append(label(LEFT_PX - 5, y + 3, f"{number * step:g}", "tick", "end"))
    step = nice_step(frame.x_high - frame.x_low, 7)
    for number in range(math.ceil(frame.x_low / step), math.floor(frame.x_high / step) + 1):
        parts.append(label(frame.x(number * step), HEIGHT_PX - 12, f"{number * step:g}", "tick", "middle"))
    parts.append(label(WIDTH_PX - RIGHT_PX, HEIGHT_PX - 1, x_name, "tick", "end"))
    return parts


def _mark(frame: _Frame, mark: Mark, number: int) -> str:
    x = frame.x(mark.x)
    if mark.until is None:
        line = tag("line", x1=x, y1=TOP_PX, x2=x, y2=HEIGHT_PX - BOTTOM_PX, class_=mark.css)
        return line + (label(x + 3, TOP_PX + 9 + 11 * (number % 4), mark.name, "tick") if mark.name else "")
    width = max(2.0, frame.x(mark.until) - x)
    height = HEIGHT_PX - BOTTOM_PX - TOP_PX
    return tag("rect", x=x, y=TOP_PX, width=width, height=height, class_="band")


def _curve(frame: _Frame, curve: Curve) -> str:
    xs, ys = np.asarray(curve.xs, dtype=float), np.asarray(curve.ys, dtype=float)
    keep = _thinned(ys)
    xs, ys = xs[keep], np.clip(ys[keep], frame.y_low, frame.y_high)
    if curve.step:
        xs, ys = np.repeat(xs, 2)[1:], np.repeat(ys, 2)[:-1]
    good = np.isfinite(xs) & np.isfinite(ys)
    places = ((frame.x(x), frame.y(y)) for x, y in zip(xs[good].tolist(), ys[good].tolist(), strict=True))
    return tag("polyline", points=points(places), class_=f"curve {curve.css}")


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
    parts = []
    x = WIDTH_PX - RIGHT_PX
    for curve in reversed(curves):
        parts.append(label(x, 13, curve.name, "tick", "end"))
        x -= 6.0 * len(curve.name) + 6
        parts.append(tag("line", x1=x - 14, y1=9.0, x2=x, y2=9.0, class_=f"curve {curve.css}"))
        x -= 24
    return "".join(parts)
