"""The page deploy/docs/rq3.md: the words of `pages/rq3.md` with the figures of the rows of `scripts/bench rq3`."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from statistics import median
from string import Template

import numpy as np
from _bootstrap import bootstrap_95
from _markdown import table
from _models import told_models
from _paired import Paired, compare, holm
from _rq3_cell import CHOOSERS, MISSIONS, MUTANTS, POPULATION, STRATEGIES, Row
from _rq3_reflights import Reflown

from saflite.contract.interval import wilson
from saflite.contract.rng import derive

SEEDS, FLIGHTS = 5, 40
PAIRS_MIN = 6  # resampling fewer says more than is known
GROUPS_MIN = 5  # strategies or choosers resampled as a whole
HERE = Path(__file__).resolve().parent
PAPER, TEMPLATE = HERE / "data" / "paper_rq3.csv", HERE / "pages" / "rq3.md"

Figure = Callable[[Row], float]


def page(rows: Sequence[Row], reflown: Sequence[Reflown], again: Sequence[Row] = ()) -> str:
    """Return the page in Markdown; `again` are cells of the rows, run once more by a later build of the vehicle."""
    rows = [row for row in rows if row.cell.flights == FLIGHTS]
    columns = _choosers(rows)
    enough_s = float(np.quantile([row.core_s[-1] for row in rows], 0.1)) if rows else 0.0
    choosers = [(name, "random") for name in columns if name != "random"]
    strategies = [(name, "random_boxes") for name in STRATEGIES if name != "random_boxes"]
    figures = {
        "mutants": MUTANTS,
        "flights": FLIGHTS,
        "population": POPULATION,
        "seeds": SEEDS,
        "done": len(rows),
        "asked": len(STRATEGIES) * len(MISSIONS) * len(columns) * SEEDS,
        "blocks": _blocks(rows),
        "builds": len({row.build for row in rows}),
        "again": _again(rows, again),
        "others": sum(row.answered_by_others for row in rows),
        "llm": told_models(set(columns) - set(CHOOSERS)),
        "coverage": _coverage(rows, columns),
        "violations": _grid(rows, lambda cells: _mean(cells, violations)),
        "confirmed": _grid(rows, lambda cells: _confirmed(cells, reflown)),
        "flown_again": len(reflown),
        "held_again": sum(not one.is_confirmed for one in reflown),
        "found": sum(len(row.found) for row in rows),
        "behaviours": _grid(rows, lambda cells: _mean(cells, behaviours)),
        "firsts": _grid(rows, _first),
        "minutes": f"{enough_s / 60:.1f}",
        "short": sum(row.core_s[-1] < enough_s for row in rows),
        "within": _grid(rows, lambda cells: _mean(cells, lambda row: within(row, enough_s))),
        "choosers": _compared(rows, choosers, "chooser"),
        "strategies": _compared(rows, strategies, "strategy"),
        "paper": _paper(),
    }
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(figures)


# ---- what is there ------------------------------------------------------------------------------------------------


def _choosers(rows: Iterable[Row]) -> list[str]:
    return [*CHOOSERS, *sorted({row.cell.chooser for row in rows} - set(CHOOSERS))]


def _blocks(rows: Sequence[Row]) -> str:
    counts = Counter((row.cell.mission, row.cell.rng_seed) for row in rows)
    alike: dict[tuple[int, int], list[int]] = {}
    for (mission, seed), count in sorted(counts.items()):
        alike.setdefault((mission, count), []).append(seed)
    told = (
        f"{count} of mission {mission} seed {', '.join(map(str, seeds))}" for (mission, count), seeds in alike.items()
    )
    return "; ".join(told)


def _again(rows: Sequence[Row], again: Sequence[Row]) -> str:
    """Say how many cells of an older build a newer one flies alike, and in how much more processor time."""
    first = {row.cell: row for row in rows}
    pairs = [(first[row.cell], row) for row in again if row.cell in first and first[row.cell].build != row.build]
    if not pairs:
        return ""
    alike = sum(old.distances_m == new.distances_m for old, new in pairs)
    longer = median(new.core_s[-1] / old.core_s[-1] for old, new in pairs)
    return (
        f"{len(pairs)} cells of the older build were run again by the newer: {alike} alike in every flight, "
        f"in {longer:.2f} times the processor time (median), by which the columns of the newer are to be read."
    )


def _coverage(rows: Sequence[Row], columns: Sequence[str]) -> str:
    done = Counter((row.cell.strategy, row.cell.chooser) for row in rows)
    whole = len(MISSIONS) * SEEDS
    lines = [(name, *(f"{done[name, chooser]} of {whole}" for chooser in columns)) for name in STRATEGIES]
    return table(("strategy", *columns), lines)


# ---- what was found -----------------------------------------------------------------------------------------------


def violations(row: Row) -> float:
    """Return how many flights violated."""
    return float(len(row.found))


def behaviours(row: Row) -> float:
    """Return how many different violations there were."""
    return float(len({one.behaviour for one in row.found}))


def first(row: Row) -> float:
    """Return the flight of the first violation, infinite where there was none."""
    return float(row.found[0].flight) if row.found else float("inf")


def within(row: Row, core_s: float) -> float:
    """Return how many flights violated before so much processor time was spent."""
    return float(sum(row.core_s[one.flight - 1] <= core_s for one in row.found))


def _grid(rows: Sequence[Row], told: Callable[[list[Row]], str]) -> str:
    columns = _choosers(rows)
    lines = []
    for strategy in STRATEGIES:
        cells = [[row for row in rows if (row.cell.strategy, row.cell.chooser) == (strategy, one)] for one in columns]
        lines.append((strategy, *(told(cell) if cell else "missing" for cell in cells)))
    return table(("strategy", *columns), lines)


def _mean(cells: list[Row], figure: Figure) -> str:
    values = np.array([figure(row) for row in cells])
    low, high = bootstrap_95(lambda index: float(values[index].mean()), len(values), derive(1, "rq3", len(values)))
    interval = "" if np.isnan(low) else f" [{low:.1f}, {high:.1f}]"
    return f"{values.mean():.1f}{interval}, n {len(values)}"


def _confirmed(cells: list[Row], reflown: Sequence[Reflown]) -> str:
    mine = {row.cell for row in cells}
    known = [one for one in reflown if one.cell in mine]
    held = sum(one.is_confirmed for one in known)
    if not known:
        return "none flown again"
    share = wilson(held, len(known))
    return f"{held} of {len(known)} [{share.low:.0%}, {share.high:.0%}]"


def _first(cells: list[Row]) -> str:
    firsts = [first(row) for row in cells]
    never = sum(np.isinf(value) for value in firsts)
    middle = median(firsts)
    return f"{'none' if np.isinf(middle) else f'{middle:g}'} ({never} of {len(cells)})"


# ---- tests -------------------------------------------------------------------------------------------------------


def _compared(rows: Sequence[Row], arms: Sequence[tuple[str, str]], word: str) -> str:
    rest = "strategy" if word == "chooser" else "chooser"
    found = [_paired(rows, one, other, word, rest) for one, other in arms]
    lines = [
        (f"`{one}` - `{other}`", paired.pairs, *_numbers(paired, p), wide)
        for (one, other), (paired, wide), p in zip(arms, found, holm([paired.p for paired, _ in found]), strict=True)
    ]
    over = "strategies" if rest == "strategy" else "choosers"
    return table(("comparison", "pairs", "difference", "p (Holm)", "effect", "detectable", f"over {over}"), lines)


def _paired(rows: Sequence[Row], one: str, other: str, word: str, rest: str) -> tuple[Paired, str]:
    """Return the comparison, and its interval where the `rest` that were run are taken for a draw of many."""

    def arm(name: str) -> dict[tuple[object, ...], float]:
        mine = [row for row in rows if getattr(row.cell, word) == name]
        return {(row.cell.rng_seed, row.cell.mission, getattr(row.cell, rest)): violations(row) for row in mine}

    here, there = arm(one), arm(other)
    tasks = sorted(here.keys() & there.keys(), key=str)
    paired = compare([here[task] for task in tasks], [there[task] for task in tasks], derive(1, "rq3", one, other))
    groups: dict[object, list[float]] = {}
    for task in tasks:
        groups.setdefault(task[-1], []).append(here[task] - there[task])
    return paired, _over_groups(list(groups.values()), derive(1, "rq3 groups", one, other))


def _over_groups(groups: Sequence[list[float]], rng: np.random.Generator) -> str:
    if len(groups) < GROUPS_MIN:
        return "-"
    drawn = bootstrap_95(lambda chosen: float(np.mean(np.concatenate([groups[i] for i in chosen]))), len(groups), rng)
    return f"[{drawn[0]:+.1f}, {drawn[1]:+.1f}]"


def _numbers(paired: Paired, p: float) -> tuple[str, ...]:
    if paired.pairs == 0:
        return ("missing",) * 4
    interval = "" if paired.pairs < PAIRS_MIN else f" [{paired.low:+.1f}, {paired.high:+.1f}]"
    return (
        f"{paired.difference:+.1f}{interval}",
        "-" if np.isnan(p) else "< 0.01" if p < 0.01 else f"{p:.2f}",
        "-" if np.isnan(paired.effect) else f"{paired.effect:.2f}",
        "-" if np.isnan(paired.detectable) else f"{paired.detectable:.1f}",
    )


# ---- the paper ----------------------------------------------------------------------------------------------------


def _paper() -> str:
    with PAPER.open(newline="", encoding="utf-8") as file:
        counts = [
            (row["tool"], row["llm"], int(row["mission"]), int(row["valid_tests"])) for row in csv.DictReader(file)
        ]
    arms = list(dict.fromkeys((tool, llm) for tool, llm, *_ in counts))
    lines = []
    for arm in arms:
        mine = {mission: tests for tool, llm, mission, tests in counts if (tool, llm) == arm}
        lines.append((arm[0], arm[1], *(mine[mission] for mission in MISSIONS), sum(mine.values())))
    return table(("tool", "model", *map(str, MISSIONS), "sum"), lines)
