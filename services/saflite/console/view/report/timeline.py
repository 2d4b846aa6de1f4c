"""The moments around a violation: each input at its time in a lane of its kind, the signals of the rule below."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from saflite.console.view.html_text import escape
from saflite.console.view.report import charts
from saflite.console.view.report.svg import label, nice_step, tag
from saflite.contract.flight import Given, Trace
from saflite.contract.test_case import stimulus_text
from saflite.contract.verdict import Verdict

BEFORE_S, AFTER_S = 8.0, 4.0
SIGNALS_MAX = 4
LANE_PX, HEAD_PX, FOOT_PX = 34.0, 22.0, 16.0


def around(trace: Trace, verdict: Verdict, given: Sequence[Given], needed: Sequence[str]) -> list[str]:
    """Return the lanes of inputs and a chart of each signal of the rule, from before the witness until after it."""
    from_s = max(0.0, verdict.witness_from_s - BEFORE_S)
    until_s = min(trace.duration_s, max(verdict.witness_to_s, verdict.witness_from_s + 1.0) + AFTER_S)
    if until_s <= from_s:
        return []
    drawn = [_lanes(given, verdict, from_s, until_s)] if given else []
    shown = [name for name in needed if name in trace.signals][:SIGNALS_MAX]
    return drawn + [_signal(trace, name, verdict, given, from_s, until_s) for name in shown]


def _signal(trace: Trace, name: str, verdict: Verdict, given: Sequence[Given], from_s: float, until_s: float) -> str:
    times = np.arange(trace.samples, dtype=np.float64) * trace.step_s
    inside = (times >= from_s) & (times <= until_s)
    marks = [charts.Mark(max(from_s, verdict.witness_from_s), until=min(until_s, verdict.witness_to_s))]
    marks += [charts.Mark(one.stimulus.at_s) for one in given if from_s <= one.stimulus.at_s <= until_s]
    curve = charts.Curve(times[inside], trace.array(name)[inside].astype(float))
    return charts.chart(f"{name} around the violation", [curve], x_name="s", marks=marks)


def _lanes(given: Sequence[Given], verdict: Verdict, from_s: float, until_s: float) -> str:
    kinds = list(dict.fromkeys(one.stimulus.kind for one in given))
    height = HEAD_PX + LANE_PX * len(kinds) + FOOT_PX
    span = charts.WIDTH_PX - 90.0 - charts.RIGHT_PX

    def x(at_s: float) -> float:
        return 90.0 + (min(until_s, max(from_s, at_s)) - from_s) / (until_s - from_s) * span

    parts = [label(0, 13, "inputs around the violation, others at the edges", "title")]
    band = max(2.0, x(verdict.witness_to_s) - x(verdict.witness_from_s))
    parts.append(
        tag(
            "rect", x=x(verdict.witness_from_s), y=HEAD_PX, width=band, height=height - HEAD_PX - FOOT_PX, class_="band"
        )
    )
    for row, kind in enumerate(kinds):
        y = HEAD_PX + LANE_PX * (row + 0.5)
        parts.append(label(0, y + 4, kind.replace("_", " "), "tick"))
        parts.append(tag("line", x1=90.0, y1=y, x2=charts.WIDTH_PX - charts.RIGHT_PX, y2=y, class_="grid"))
        parts += _lane([one for one in given if one.stimulus.kind == kind], x, y)
    step = nice_step(until_s - from_s, charts.TICKS)
    for number in range(int(np.ceil(from_s / step)), int(np.floor(until_s / step)) + 1):
        parts.append(label(x(number * step), height - 3, f"{number * step:g} s", "tick", "middle"))
    size = f"0 0 {charts.WIDTH_PX:.0f} {height:.0f}"
    return tag("svg", "".join(parts), viewBox=size, class_="chart", role="img")


def _lane(given: Sequence[Given], x: Callable[[float], float], y: float) -> list[str]:
    parts, ends = [], [0.0, 0.0]  # names over the line and under it
    for one in given:
        place = x(one.stimulus.at_s)
        text = f"{one.stimulus.at_s:g} s {stimulus_text(one.stimulus)}, {one.answer}"
        title = tag("title", escape(text))
        parts.append(tag("circle", title, cx=place, cy=y, r=4.0, class_="given" if one.is_cause else "given denied"))
        name = one.stimulus.name[:18]
        width = charts.CHAR_PX * len(name) + 6
        left = place - 4 if place - 4 + width < charts.WIDTH_PX else charts.WIDTH_PX - width
        side = next((side for side, end in enumerate(ends) if end <= left), None)
        if side is not None:
            ends[side] = left + width
            parts.append(label(left, y - 7 if side == 0 else y + 14, name, "tick name"))
    return parts
