"""`scripts/bench rq2`: the paper's second question. Among a policy's inputs, does a model find the one that triggers?

    scripts/bench rq2 [--models NAME|ollama:TAG ...] [--arms paper none] [--seeds 5] [--out FILE.jsonl]
    scripts/bench rq2 --page            # writes deploy/docs/rq2.md from the rows

One row per model, words told, seed of the values and bug; those in the file are not asked again. A model that cannot
be had is told, and stays missing.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from string import Template
from typing import Any

import msgspec
import numpy as np
from _markdown import table
from _models import check_none, missing, told_models

from saflite.console.evaluation.bugs import BugResult, Words, bugs, evaluate_bug, gain
from saflite.contract.interval import Interval
from saflite.mutator.operators.inputs import published_inputs
from saflite.runtime.clock import WallClock
from saflite.runtime.stages import brief_of

HERE = Path(__file__).resolve().parent
ROWS, TEMPLATE = HERE / "results" / "rq2.jsonl", HERE / "pages" / "rq2.md"
PAGE = HERE.parents[1] / "deploy" / "docs" / "rq2.md"
AIM = 2.0
DEADLINE_S = 1800.0
"""For a batch: however slow a model is, its own scores are asked for."""
MODELS = ("relevance", "random", "constant")
ARMS: dict[str, tuple[Words, bool]] = {
    "paper": ("paper", True),
    "paper, value unknown": ("paper", False),
    "ours": ("policy", True),
    "none": ("none", True),
}
"""What the model is told of the policy, and whether the trigger bears the value of the report or one drawn."""


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """What a model made of one bug, told so much, with values from so seeded draws."""

    arm: str
    rng_seed: int
    result: BugResult


def rows(path: Path) -> list[Row]:
    """Return the rows of a file, none without it."""
    lines = path.read_bytes().splitlines() if path.exists() else []
    return [msgspec.json.decode(line, type=Row) for line in lines if line.strip()]


def measure(models: Sequence[str], arms: Sequence[str], seeds: int, path: Path) -> Iterator[Row]:
    """Ask what has not been asked yet; raises Unavailable at the end for a model that is not there."""
    done = {(row.result.model, row.arm, row.rng_seed, row.result.bug) for row in rows(path)}
    lacking = missing(models)
    for model in [model for model in models if model not in lacking]:
        for arm in arms:
            words, valued = ARMS[arm]
            for rng_seed in range(1, seeds + 1):
                for bug in bugs():
                    if (model, arm, rng_seed, bug.id) in done:
                        continue
                    asked = bug if valued else msgspec.structs.replace(bug, trigger_values=())
                    result = evaluate_bug(
                        asked,
                        model,
                        published_inputs,
                        brief_of,
                        WallClock(),
                        rng_seed=rng_seed,
                        words=words,
                        deadline_s=DEADLINE_S,
                    )
                    yield Row(arm=arm, rng_seed=rng_seed, result=result)
    check_none(lacking)


# ---- the page -----------------------------------------------------------------------------------------------------


def page(found: Sequence[Row]) -> str:
    """Return the page in Markdown: the words of `pages/rq2.md` with the figures of the rows."""
    models = list(dict.fromkeys([*MODELS, *(row.result.model for row in found)]))
    by_arm = {key: [row.result for row in group] for key, group in _grouped(found)}
    gains = {(model, arm): gain(by_arm.get((model, arm), [])) for model in models for arm in ARMS}
    headline = gains["relevance", "paper"]
    heads = ("model", *(f"told: {arm}" for arm in ARMS))
    figures: dict[str, object] = {
        "headline": _told(headline),
        "aim": "met" if (headline.value or 0.0) >= AIM else "missed",
        "rows": len(found),
        "seeds": len({row.rng_seed for row in found}),
        "gains": table(heads, [(f"`{model}`", *(_told(gains[model, arm]) for arm in ARMS)) for model in models]),
        "triggers": _triggers(by_arm),
        "llm": told_models(set(models) - set(MODELS)),
        "others": sum(
            count for row in found for name, count in row.result.scored_by.items() if name != row.result.model
        ),
    }
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(figures)


def _grouped(found: Sequence[Row]) -> Iterator[tuple[tuple[str, str], list[Row]]]:
    def key(row: Row) -> tuple[str, str]:
        return row.result.model, row.arm

    for name, group in groupby(sorted(found, key=key), key=key):
        yield name, list(group)


def _triggers(by_arm: dict[tuple[str, str], list[BugResult]]) -> str:
    names = dict.fromkeys(bug.trigger.name for bug in bugs())
    lines: list[tuple[Any, ...]] = []
    for name in names:
        cells = [[one for one in by_arm.get(("relevance", arm), []) if one.trigger == name] for arm in ARMS]
        first = cells[0]
        share = f"{np.mean([one.trigger_rank / one.inputs for one in first]):.0%}" if first else "missing"
        ids = ", ".join(bug.id for bug in bugs() if bug.trigger.name == name)
        lines.append((f"`{name}`", ids, share, *(f"{gain(cell).value:.2f}" if cell else "missing" for cell in cells)))
    return table(("trigger", "bugs", "rank, of all inputs", *(f"gain, {arm}" for arm in ARMS)), lines)


def _told(figure: Interval) -> str:
    if figure.value is None:
        return "missing"
    return f"{figure.value:.2f}" + ("" if figure.low is None else f" [{figure.low:.1f}, {figure.high:.1f}]")


def main(argv: list[str]) -> int:
    """Ask, or write the page."""
    parser = argparse.ArgumentParser(prog="scripts/bench rq2", description=__doc__)
    parser.add_argument("--models", nargs="+", default=list(MODELS))
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--out", type=Path, default=ROWS)
    parser.add_argument("--page", action="store_true", help="write deploy/docs/rq2.md from the rows")
    options = parser.parse_args(argv)
    if options.page:
        PAGE.write_text(page(rows(options.out)), encoding="utf-8")
        print(f"wrote {PAGE}")
        return 0
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for row in measure(options.models, options.arms, options.seeds, options.out):
        with options.out.open("ab") as file:
            file.write(msgspec.json.encode(row) + b"\n")
    return 0
