"""`scripts/bench rq3`: the paper's third question. Which tool, with which choice among five mutants, finds most?

    scripts/bench rq3 [--strategies NAME ...] [--missions 2 ...] [--choosers NAME|ollama:TAG ...] [--seeds 5]
                      [--flights 40] [--minutes M] [--out FILE.jsonl]
    scripts/bench rq3 --confirm         # flies what violated again under other noise, where that was not done yet
    scripts/bench rq3 --page            # writes deploy/docs/rq3.md from the rows
    scripts/bench rq3 --farm            # the same campaign in a real farm with its bus: the same finds?

Every cell is one campaign in one process: strategy x mission x chooser x seed. Rows are appended as campaigns end, and
cells that have one are not run again, so the table can be made in pieces; after `--minutes` no cell is begun.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import groupby, product
from pathlib import Path

import msgspec
from _models import check_none, missing
from _rq3_cell import CHOOSERS, MISSIONS, STRATEGIES, Cell, Memory, Row, run, scorer_of

HERE = Path(__file__).resolve().parent
REFLIGHTS, AGAIN = "rq3_reflights.jsonl", "rq3_again.jsonl"
ROWS = HERE / "results" / "rq3.jsonl"
REFLIGHT_ROWS = ROWS.with_name(REFLIGHTS)
PAGE = HERE.parents[1] / "deploy" / "docs" / "rq3.md"
SEEDS = 5


def rows(path: Path) -> list[Row]:
    """Return the rows of a file, the last one of each cell; none without the file."""
    if not path.exists():
        return []
    found = (msgspec.json.decode(line, type=Row) for line in path.read_bytes().splitlines() if line.strip())
    return list({row.cell: row for row in found}.values())


def wanted(options: argparse.Namespace) -> list[Cell]:
    """Return the cells asked for: all tools and choices of a mission and seed before the next."""
    places = product(range(1, options.seeds + 1), options.missions, options.strategies, options.choosers)
    return [Cell(*place, options.flights) for place in places]


def measure(options: argparse.Namespace) -> Iterator[Row]:
    """Run the cells that have no row, until the time is up; raises Unavailable at the end for a chooser not there."""
    done = {row.cell for row in rows(options.out)}
    cells = [cell for cell in wanted(options) if cell not in done]
    lacking = missing([scorer_of(cell.chooser) for cell in cells])
    end_s = time.monotonic() + 60.0 * options.minutes
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for _, group in groupby(cells, key=lambda cell: (cell.rng_seed, cell.mission, cell.strategy)):
        memory = Memory()
        for cell in group:
            if scorer_of(cell.chooser) in lacking:
                continue
            if time.monotonic() > end_s:
                return
            row = run(cell, memory)
            with options.out.open("ab") as file:
                file.write(msgspec.json.encode(row) + b"\n")
            yield row
    check_none(lacking)


def confirm(path: Path, minutes: float) -> None:
    """Fly again what has not been, until the time is up."""
    from _rq3_reflights import read, reflights

    notes, end_s = path.with_name(REFLIGHTS), time.monotonic() + 60.0 * minutes
    for one in reflights(rows(path), read(notes)):
        with notes.open("ab") as file:
            file.write(msgspec.json.encode(one) + b"\n")
        if time.monotonic() > end_s:
            return


def page(found: Sequence[Row], reflown: Path = REFLIGHT_ROWS) -> str:
    """Return the page of the rows and of what was flown again."""
    from _rq3_page import page as made
    from _rq3_reflights import read

    return made(found, read(reflown), rows(reflown.with_name(AGAIN)))


def main(argv: list[str]) -> int:
    """Run cells, or write the page."""
    parser = argparse.ArgumentParser(prog="scripts/bench rq3", description=__doc__)
    parser.add_argument("--strategies", nargs="+", choices=STRATEGIES, default=list(STRATEGIES))
    parser.add_argument("--missions", type=int, nargs="+", choices=MISSIONS, default=list(MISSIONS))
    parser.add_argument("--choosers", nargs="+", default=list(CHOOSERS), help=f"{', '.join(CHOOSERS)}, ollama:TAG")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--flights", type=int, default=40, help="budget of a campaign")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no cell after so long")
    parser.add_argument("--out", type=Path, default=ROWS)
    parser.add_argument("--page", action="store_true", help="write deploy/docs/rq3.md from the rows")
    parser.add_argument("--confirm", action="store_true", help="fly again what violated, under other noise")
    parser.add_argument("--farm", action="store_true", help="compare one campaign with the same in a real farm")
    options = parser.parse_args(argv)
    if options.page:
        PAGE.write_text(page(rows(options.out), options.out.with_name(REFLIGHTS)), encoding="utf-8")
        print(f"wrote {PAGE}")
        return 0
    if options.confirm:
        confirm(options.out, options.minutes)
        return 0
    if options.farm:
        from _rq3_farm import compare

        return compare(wanted(options)[0])
    for row in measure(options):
        seed, mission, strategy, chooser, _ = msgspec.structs.astuple(row.cell)
        told = f"{len(row.found)} violations in {len(row.distances_m)} flights, {row.core_s[-1]:.0f} s of a core"
        sys.stderr.write(f"seed {seed} mission {mission} {strategy} {chooser}: {told}\n")
    return 0
