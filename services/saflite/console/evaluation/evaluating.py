"""What `saflite evaluate` does: reads logs and labels, asks the models, prints and draws what came of it."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from saflite.console.evaluation.bugs import BugResult, evaluate_bugs, gain
from saflite.console.evaluation.labels import Labels, read_labels
from saflite.console.evaluation.logs import LogCase, LogReport, Missing, evaluate_logs
from saflite.console.io import outputs
from saflite.console.view import out
from saflite.console.view.report import bars
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.interval import Interval
from saflite.flight.logs.files import SUFFIXES, read_trace
from saflite.scorer_pool.calibration import Calibration

POSITION = ("x_m", "y_m", "altitude_m")


# ---- logs -------------------------------------------------------------------------------------------------------


def logs(args: argparse.Namespace) -> int:
    """Judge the logs of a folder and print how well that meets the labels.

    Raises:
        Unavailable: the model cannot be asked; everything else is printed first.
    """
    from saflite.runtime.clock import WallClock

    if args.text is not None:
        outputs.check_folder(args.text, force=args.force, option="--text")
    if args.plot is not None:
        outputs.check_file(args.plot, force=args.force, option="--plot")
    cases, missing = read_cases(args.folder, read_labels(args.labels) if args.labels else Labels({}), args.text)
    report = evaluate_logs(cases, args.model, WallClock(), deadline_s=args.deadline, missing=missing)
    if args.plot is not None:
        outputs.write(args.plot, bars.calibrations(report.calibrations).encode(), force=args.force, option="--plot")
    if args.json:
        out.json(report)
    else:
        _show_logs(report)
    if report.unavailable:
        raise Unavailable(f"{args.model} answered nothing: {report.unavailable}")
    return 0


def read_cases(folder: Path, labels: Labels, text_folder: Path | None = None) -> tuple[list[LogCase], Missing]:
    """Return the logs of a folder as text with their labels, and what of labels and logs could not be read."""
    from saflite.oracle.log_text import describe, facts_of, rule_of_thumb
    from saflite.recorder import recording

    paths = _logs_in(folder)
    names = {path: path.relative_to(folder) for path in paths}
    given = labels.by_log(names.values())
    texts = _text_names(names.values())
    found, unreadable, without_position = [], [], []
    for path, name in names.items():
        try:
            trace = recording.read(path).trace if path.suffix == ".mcap" else read_trace(path, placed=False)
        except Refused as fault:  # one bad log does not spoil the others; it is named and counted
            out.complain("left out", str(fault))
            unreadable.append(name.as_posix())
            continue
        if not all(name in trace.signals for name in POSITION):
            without_position.append(name.as_posix())
        text = describe(trace)
        if text_folder is not None:
            outputs.write(text_folder / texts[name], text.encode(), force=True)
        label = labels.answers.get(given[name])
        found.append(LogCase(name.as_posix(), text, label, *rule_of_thumb(facts_of(trace))))
    return found, Missing(labels.without_log(names.values()), tuple(unreadable), tuple(without_position))


def _text_names(names: Iterable[Path]) -> dict[Path, Path]:
    """Return a file for the text of each log, below one folder; logs that differ in their suffix only keep it."""
    plain = {name: name.with_suffix(".txt") for name in names}
    met = Counter(plain.values())
    return {name: text if met[text] == 1 else name.with_name(f"{name.name}.txt") for name, text in plain.items()}


def _logs_in(folder: Path) -> list[Path]:
    from saflite.flight.logs.extract import is_extract

    if not folder.is_dir():
        raise Refused("logs", where=str(folder), expected="a folder with flight logs", got="none")
    known = {".mcap", *SUFFIXES}
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in known and path.is_file())
    paths = [path for path in files if path.suffix != ".csv" or is_extract(path)]
    if not paths:
        raise Refused("logs", where=str(folder), expected=f"files ending in {', '.join(sorted(known))}", got="none")
    return paths


def _show_logs(report: LogReport) -> None:
    rows = [
        (answer.log, answer.answerer, "-" if answer.score is None else f"{answer.score:.1f}",
         _word(answer.interesting), _word(answer.label), answer.fault or answer.reason[:70])
        for answer in report.answers
        if answer.answerer != "random"
    ]  # fmt: skip
    out.table(rows, ("log", "answered by", "score", "called", "label", "because"))
    out.line()
    missing = report.missing
    out.line(f"{report.labelled} labelled logs, {report.unlabelled} without label; 95 % intervals")
    out.line(
        f"in no figure: {len(missing.without_log)} labels without a log, {len(missing.unreadable)} logs that cannot be "
        f"read; without a position, told by what else they hold: {len(missing.without_position)}"
    )
    if report.labelled:
        heads = (
            "answered by",
            "N",
            "no answer",
            "TP/FP/FN/TN",
            "accuracy",
            "precision",
            "recall",
            "F1",
            "ROC area",
            "always: F1",
            "accuracy",
            "never: accuracy",
        )
        out.table([_figures(one, report.unanswered[one.model]) for one in report.calibrations], heads)


def _figures(one: Calibration, unanswered: int) -> tuple[object, ...]:
    counts, metrics = one.metrics.confusion, one.metrics
    four = f"{counts.true_positive}/{counts.false_positive}/{counts.false_negative}/{counts.true_negative}"
    figures = (metrics.accuracy, metrics.precision, metrics.recall, metrics.f1, one.roc_area)
    constants = (one.always.f1.value, one.always.accuracy.value, one.never.accuracy.value)
    return (one.model, one.flights, unanswered, four, *map(_interval, figures), *map(_number, constants))


def _interval(figure: Interval) -> str:
    if figure.value is None or figure.low is None or figure.high is None:
        return _number(figure.value)
    return f"{figure.value:.2f} [{figure.low:.2f}, {figure.high:.2f}]"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _word(interesting: bool | None) -> str:
    return "-" if interesting is None else "interesting" if interesting else "dull"


# ---- bugs -------------------------------------------------------------------------------------------------------


def bugs(args: argparse.Namespace) -> int:
    """Score all inputs of the ten bugs and print where their triggers stand."""
    from saflite.mutator.operators.inputs import published_inputs
    from saflite.runtime.clock import WallClock
    from saflite.runtime.stages import brief_of
    from saflite.scorer_pool.registry import check_label

    check_label(args.model)
    results = evaluate_bugs(
        args.model,
        published_inputs,
        brief_of,
        WallClock(),
        rng_seed=args.rng_seed,
        deadline_s=args.deadline,
        words=args.words,
    )
    if args.plot is not None:
        outputs.write(args.plot, bars.bugs(results).encode(), force=args.force, option="--plot")
    if args.json:
        out.json({"results": results, "gain_over_pgfuzz": gain(results)})
    else:
        _show_bugs(results, args.model)
    return 0


def _show_bugs(results: Sequence[BugResult], model: str) -> None:
    rows = [
        (
            *(one.bug, one.policy, one.trigger, one.inputs),
            f"{one.bands['interesting']:.0f}/{one.bands['middling']:.0f}/{one.bands['dull']:.0f} %",
            *(f"{one.trigger_score:.1f} {one.trigger_band}", f"{one.trigger_rank:g}", f"{one.published_score:g}"),
            *(
                f"{100 * one.chance_pgfuzz:.2f} %",
                f"{100 * one.chance_weighted:.2f} %",
                f"{100 * one.chance_band:.2f} %",
            ),
        )
        for one in results
    ]
    heads = (
        *("bug", "policy", "trigger", "inputs", "high/mid/low", "trigger score", "rank", "paper's score"),
        *("by PGFuzz", "by score", "from best band"),
    )
    out.table(rows, heads)
    answered = sorted({name for one in results for name in one.scored_by})
    faults = sum(sum(one.faults.values()) for one in results)
    out.line(f"asked {model}, answered by {', '.join(answered)}, {faults} faults")
    triggers = len({one.trigger for one in results})
    told = f"{_interval(gain(results))} x PGFuzz's own (geometric mean over {triggers} triggers, 95 %)"
    out.line(f"chance per round of drawing the trigger: {told}")
