"""What a formula is worth on a flight: how far it was from being broken, when, and where it applied."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from saflite.oracle.formula import Node, parts_of, reach_s
from saflite.oracle.stl import Evaluator
from saflite.oracle.windows import Array


class Finding(NamedTuple):
    """What a formula is worth on a trace. `robustness` is infinite where only crisp parts decided, NaN on gaps.

    The witness window is the stretch of time that decided; `applied_share` the share of the samples at which the
    rule's condition held (1 for rules without one); `judged_s` the time over which the rule could be judged;
    `nearness` the greatest share of the condition's parts that were true at once (1 where it applied);
    `applied_from_s` when it first held, None where it never did or there is none.
    """

    robustness: float
    witness_from_s: float
    witness_to_s: float
    applied_share: float
    judged_s: float
    nearness: float = 1.0
    applied_from_s: float | None = None


def find(evaluator: Evaluator, formula: Node) -> Finding | None:
    """Return what `formula` is worth on the trace, None if the trace is shorter than the formula's windows.

    A formula `always body` is judged only where the body's windows lie wholly inside the trace, so a promise that
    could still be kept when the flight ended is no violation. What is not known (a signal with gaps) leaves open
    whether it held, not whether it was broken elsewhere.
    """
    step_s, row = evaluator.step_s, evaluator.row
    samples = int(row[-1]) + 1 if len(row) else 0
    body = _body(formula)
    judged = body if body is not None else formula
    ahead = reach_s(judged)
    last_row = samples - (math.ceil(ahead / step_s - 1e-9) if math.isfinite(ahead) else 0)
    first_row = round(formula.low_s / step_s) if body is not None else 0
    first, last = (int(place) for place in np.searchsorted(row, (first_row, last_row)))
    last = last if body is not None else min(last, 1)
    if last <= first:
        return None
    values = evaluator.trace(judged)[first:last]
    at = int(np.argmin(np.where(np.isnan(values), np.inf, values) if (values < 0).any() else values))
    start, end = _stretch(values, at)
    window = ahead if math.isfinite(ahead) else (samples - 1) * step_s
    applied = _applied(evaluator, judged, first, last)
    applied_at = _applied_first(evaluator, judged, first, last)
    return Finding(
        robustness=float(values[at]),
        witness_from_s=float(row[first + start]) * step_s,
        witness_to_s=min(float(row[first + end]) * step_s + window, (samples - 1) * step_s),
        applied_share=applied,
        judged_s=float(row[last - 1] + 1 - row[first]) * step_s,
        nearness=1.0 if applied > 0 else _nearness(evaluator, judged, first, last),
        applied_from_s=None if applied_at is None else float(row[first + applied_at]) * step_s,
    )


def begins_broken(evaluator: Evaluator, formula: Node) -> bool:
    """Whether the state at the first sample, before anything was given, breaks a rule that does not look ahead."""
    body = _body(formula)
    if body is None or formula.low_s > 0 or reach_s(body) > 0 or not evaluator.samples:
        return False
    return bool(evaluator.trace(body)[0] < 0)


def _body(formula: Node) -> Node | None:
    """Return what always has to be true, None where a formula asks for something else."""
    return formula.args[0] if formula.op == "always" and math.isinf(formula.high_s) else None


def _stretch(values: Array, at: int) -> tuple[int, int]:
    """First and last sample of the broken stretch around the worst sample; the sample alone if nothing is broken."""
    if not values[at] < 0:
        return at, at
    good = np.flatnonzero(~(values < 0))
    before, after = good[good < at], good[good > at]
    return (int(before[-1]) + 1 if len(before) else 0), (int(after[0]) - 1 if len(after) else len(values) - 1)


def _applied(evaluator: Evaluator, judged: Node, first: int, last: int) -> float:
    if judged.op == "and":
        return max(_applied(evaluator, part, first, last) for part in judged.args)
    if judged.op != "implies":
        return 1.0
    return float(np.mean(evaluator.true(judged.args[0])[first:last]))


def _applied_first(evaluator: Evaluator, judged: Node, first: int, last: int) -> int | None:
    """Return the first moment, counted from `first`, at which a condition of the rule held; None if there is none."""
    if judged.op == "and":
        places = [_applied_first(evaluator, part, first, last) for part in judged.args]
        return min((place for place in places if place is not None), default=None)
    if judged.op != "implies":
        return None
    true = evaluator.true(judged.args[0])[first:last]
    return int(true.argmax()) if true.any() else None


def _nearness(evaluator: Evaluator, judged: Node, first: int, last: int) -> float:
    """Greatest share of the parts of a condition that were true at once, so that a search can come nearer to it."""
    if judged.op != "implies":
        return max((_nearness(evaluator, part, first, last) for part in judged.args), default=0.0)
    parts = parts_of(judged.args[0])
    true = np.zeros(last - first, dtype=np.int16)
    for part in parts:
        true += evaluator.true(part)[first:last]
    return int(true.max()) / len(parts)
