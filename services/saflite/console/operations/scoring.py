"""The scorer orders of the console: use, shadow, list."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from saflite.console.io import farm_options
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.farm_lookup import Where
from saflite.console.view import out
from saflite.contract.control import Answer
from saflite.contract.errors import RefusedElsewhere
from saflite.contract.events import ScorerChanged
from saflite.contract.interval import Interval
from saflite.runtime import run_modules
from saflite.scorer_pool.calibration import Calibration
from saflite.scorer_pool.labels import split_label
from saflite.scorer_pool.registry import check_label, model_names

if TYPE_CHECKING:
    from saflite.runtime.client import FarmClient


def use(args: argparse.Namespace) -> int:
    """Order another deciding model and wait until it has taken over; 3 if it was rolled back."""
    where = farm_options.where(args)
    _check(args.model, where)
    client = farm_lookup.connect(where)
    try:
        status = client.status()
        if status.scorer == args.model:
            return _say(args, True, f"{args.model} scores already")
        answer = _accepted(client.order("scorer", text=args.model))
        if args.no_wait:
            return _say(args, True, answer.message or f"{args.model} is being warmed")
        change = _awaited(client, args.model, status.seq)
    finally:
        client.close()
    if change is None:
        return _say(args, False, "the campaign ended before the model was warm")
    if change.ready:
        return _say(args, True, f"{change.model} scores from the next batch on, {change.previous} before")
    return _say(args, False, f"{args.model} is not ready, {change.previous} stays: {change.message}")


def _awaited(client: FarmClient, model: str, from_seq: int) -> ScorerChanged | None:
    for event in client.watch(from_seq + 1):
        if isinstance(event.fact, ScorerChanged) and event.fact.model == model:
            return event.fact
    return None


def _check(label: str, where: Where) -> None:
    """Raise Refused for a model that neither this process knows nor the farm that is meant was given from outside.

    What a farm elsewhere was given is not known here: it says so itself where it cannot make the model ready.
    """
    kind, _ = split_label(label)
    if kind not in model_names():
        places = farm_lookup.running() if where.run_dir is None else [where.run_dir]
        if where.endpoint or any(kind in run_modules.names(place, "scorer") for place in places):
            return
    check_label(label)


def shadow(args: argparse.Namespace) -> int:
    """Order the models that score without deciding."""
    where = farm_options.where(args)
    for label in args.model:
        _check(label, where)
    client = farm_lookup.connect(where)
    try:
        answer = _accepted(client.order("shadow", text=",".join(args.model)))
    finally:
        client.close()
    return _say(args, True, answer.message or f"shadow scoring: {', '.join(args.model) or 'none'}")


def _accepted(answer: Answer) -> Answer:
    if not answer.accepted:
        raise RefusedElsewhere("order", answer.message)
    return answer


def _say(args: argparse.Namespace, good: bool, text: str) -> int:
    out.json({"done": good, "message": text}) if args.json else out.line(text)
    return 0 if good else 3


def show(where: Where, as_json: bool) -> int:
    """Print what scores now, the calibration of every model that did, and what calls took."""
    from saflite.console.run_data.in_force import in_force
    from saflite.console.run_data.run_folder import open_run
    from saflite.console.view.report.data import calibrations

    place = None if where.endpoint else farm_lookup.newest(where.run_dir)
    now = _now(where._replace(run_dir=place))
    if place is None:
        out.json({"scorer": now}) if as_json else out.line(f"scorer  {now}")
        return 0
    with open_run(place) as run:
        known, usage = calibrations(run), run.usage()
        now = now or in_force(run).scorer
    if as_json:
        out.json({"scorer": now, "calibration": known, "usage": [use_row._asdict() for use_row in usage]})
        return 0
    out.line(f"scorer  {now}")
    rows = [_row(one) for one in known if one.flights]
    if rows:
        heads = ("model", "sample", "flights", "violations", "accuracy", "precision", "recall", "F1", "ROC area")
        out.table(rows, heads)
    else:
        out.line("no scored test case has been flown and judged yet")
    for one in usage:
        mean_s = one.latency_s / max(1, one.batches)
        out.line(f"{one.model}: {one.batches} batches, {mean_s:.3f} s each, {one.calls} calls, {one.faults} faults")
    return 0


def _now(where: Where) -> str:
    """Return the model that decides now, empty for a run that does not work."""
    if where.run_dir is not None and not where.endpoint and not farm_lookup.says_it_runs(where.run_dir):
        return ""
    client = farm_lookup.connect(where)
    try:
        status = client.status()
    finally:
        client.close()
    return f"{status.scorer} (warming {status.scorer_pending})" if status.scorer_pending else status.scorer


def _row(one: Calibration) -> tuple[object, ...]:
    metrics = one.metrics
    figures = (metrics.accuracy, metrics.precision, metrics.recall, metrics.f1, one.roc_area)
    return (one.model, one.sample, one.flights, one.violations, *(_figure(figure) for figure in figures))


def _figure(figure: Interval) -> str:
    if figure.value is None:
        return "-"
    return (
        f"{figure.value:.2f} [{figure.low:.2f}, {figure.high:.2f}]" if figure.low is not None else f"{figure.value:.2f}"
    )
