"""`scripts/bench rq1`: the paper's first question. Told as text, is a flight log called interesting where it is?

    scripts/bench rq1 LOGS --labels FILE [--models ollama:TAG ...] [--out FILE.jsonl]
    scripts/bench rq1 --page            # writes deploy/docs/rq1.md from the rows

The logs and their labels are not part of this repository: name the folder and the file. One row per log and answerer;
labels without a log and models that cannot be had have rows too, so that they are counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Template

import msgspec
from _markdown import table
from _models import check_none, told_models

from saflite.console.evaluation.evaluating import read_cases
from saflite.console.evaluation.labels import read_labels
from saflite.console.evaluation.logs import RULE, THRESHOLD, evaluate_logs
from saflite.contract.interval import Interval
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.calibration import Confusion, Metrics, Row, calibrate, metrics

HERE = Path(__file__).resolve().parent
ROWS, TEMPLATE = HERE / "results" / "rq1.jsonl", HERE / "pages" / "rq1.md"
PAGE = HERE.parents[1] / "deploy" / "docs" / "rq1.md"
PAPER = {  # of 70 logs, 36 interesting: the smallest set that all of the paper's percentages fit
    "GPT-3.5": Confusion(true_positive=24, false_positive=10, false_negative=12, true_negative=24),
    "Mistral-7B": Confusion(true_positive=26, false_positive=16, false_negative=10, true_negative=18),
    "Llama-2-7B": Confusion(true_positive=22, false_positive=23, false_negative=14, true_negative=11),
    "always interesting": Confusion(true_positive=36, false_positive=34),
    "never": Confusion(false_negative=36, true_negative=34),
}


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """What one answerer said of one log. Without an answerer: a label without a log; `label` None: no clear one."""

    log: str
    label: bool | None
    answerer: str = ""
    score: float | None = None
    fault: str = ""
    placed: bool = True


def rows(path: Path) -> list[Answer]:
    """Return the rows of a file, none without it."""
    lines = path.read_bytes().splitlines() if path.exists() else []
    return [msgspec.json.decode(line, type=Answer) for line in lines if line.strip()]


def measure(folder: Path, labels_file: Path, models: Sequence[str]) -> Iterator[Answer]:
    """Yield the answers of the rule of thumb, of chance and of the models, and what is missing.

    Raises Unavailable at the end for a model that is not there.
    """
    labels = read_labels(labels_file)
    cases, missing = read_cases(folder, labels)
    lacking: dict[str, str] = {}
    for number, model in enumerate([RULE, *models]):
        report = evaluate_logs(cases, model, WallClock())
        lacking |= {model: report.unavailable} if report.unavailable else {}
        for one in report.answers:
            if number == 0 or one.answerer == model:
                placed = one.log not in missing.without_position
                yield Answer(
                    log=one.log, label=one.label, answerer=one.answerer, score=one.score, fault=one.fault, placed=placed
                )
    for name in missing.without_log:
        yield Answer(log=name, label=labels.answers[name], fault="no log")
    for name in missing.unreadable:
        yield Answer(log=name, label=None, fault="unreadable")
    check_none(lacking)


# ---- the page -----------------------------------------------------------------------------------------------------


def page(found: Sequence[Answer]) -> str:
    """Return the page in Markdown: the words of `pages/rq1.md` with the figures of the rows."""
    given = [one for one in found if one.answerer]
    pairs = [
        Row(one.answerer, one.score, bool(one.label))
        for one in given
        if one.label is not None and one.score is not None
    ]
    names = sorted({one.answerer for one in given})
    known = [calibrate(pairs, name, threshold=THRESHOLD) for name in names]
    silent = {name: sum(one.score is None for one in given if one.answerer == name) for name in names}
    logs = {one.log: one for one in given}
    lines = [(f"`{one.model}`", silent[one.model], *_figures(one.metrics), _told(one.roc_area)) for one in known]
    constants = [(name, 0, *_figures(figures), "0.50") for name, figures in _constants(list(logs.values()))]
    heads = ("answered by", "no answer", "TP/FP/FN/TN", "accuracy", "precision", "recall", "F1")
    figures: dict[str, object] = {
        "labels": sum(one.label is not None for one in logs.values()) + sum(one.fault == "no log" for one in found),
        "labelled": sum(one.label is not None for one in logs.values()),
        "interesting": sum(one.label is True for one in logs.values()),
        "unlabelled": sum(one.label is None for one in logs.values()),
        "no_log": sum(one.fault == "no log" for one in found),
        "unclear": sum(one.fault == "no log" and one.label is None for one in found),
        "unreadable": sum(one.fault == "unreadable" for one in found),
        "unplaced": sum(not one.placed for one in logs.values()),
        "answers": table((*heads, "ROC area"), [*lines, *constants]),
        "paper": table(
            ("the paper's", *heads[2:]), [(name, *_figures(metrics(counts))) for name, counts in PAPER.items()]
        ),
        "llm": told_models(set(names) - {RULE, "random"}),
    }
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(figures)


def _constants(logs: Sequence[Answer]) -> list[tuple[str, Metrics]]:
    yes, no = (sum(one.label is word for one in logs) for word in (True, False))
    return [
        ("always interesting", metrics(Confusion(true_positive=yes, false_positive=no))),
        ("never", metrics(Confusion(false_negative=yes, true_negative=no))),
    ]


def _figures(found: Metrics) -> tuple[str, ...]:
    counts = found.confusion
    four = f"{counts.true_positive}/{counts.false_positive}/{counts.false_negative}/{counts.true_negative}"
    return (four, *(_told(one) for one in (found.accuracy, found.precision, found.recall, found.f1)))


def _told(figure: Interval) -> str:
    if figure.value is None:
        return "-"
    return f"{figure.value:.2f}" + ("" if figure.low is None else f" [{figure.low:.2f}, {figure.high:.2f}]")


def main(argv: list[str]) -> int:
    """Ask, or write the page."""
    parser = argparse.ArgumentParser(prog="scripts/bench rq1", description=__doc__)
    parser.add_argument("logs", type=Path, nargs="?", help="folder with flight logs or extracts of them")
    parser.add_argument("--labels", type=Path, help="columns log, interesting, or log_id, shows_issue")
    parser.add_argument("--models", nargs="+", default=[], help="language models: ollama:TAG, openai:MODEL")
    parser.add_argument("--out", type=Path, default=ROWS)
    parser.add_argument("--page", action="store_true", help="write deploy/docs/rq1.md from the rows")
    options = parser.parse_args(argv)
    if options.page:
        PAGE.write_text(page(rows(options.out)), encoding="utf-8")
        print(f"wrote {PAGE}")
        return 0
    if options.logs is None or options.labels is None:
        parser.error("name the folder with the logs and --labels FILE")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("wb") as file:
        for one in measure(options.logs, options.labels, options.models):
            file.write(msgspec.json.encode(one) + b"\n")
    return 0
