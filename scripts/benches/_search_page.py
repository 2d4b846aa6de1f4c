"""The page deploy/docs/defects.md: the words of `pages/search.md` with the figures of `scripts/bench search`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean, median
from string import Template

import numpy as np
from _bootstrap import bootstrap_95
from _markdown import table
from _search_run import ARMS, OF_ONE_POLICY, Row

from saflite.contract.rng import derive
from saflite.flight.autopilots.reference.defects import TABLE

TEMPLATE = Path(__file__).resolve().parent / "pages" / "search.md"
HALVES = ("fit", "report")


class Tries:
    """The searches for one defect by one arm: flights until it was found, None where it was not."""

    def __init__(self, defect: str, half: str, rows: Iterable[Row]) -> None:
        self.defect, self.half = defect, half
        self.rows = sorted((row for row in rows if defect in row.faults), key=lambda row: (row.budget, row.rng_seed))

    @property
    def flights(self) -> list[int | None]:
        """Flights spent when it was confirmed, by seed."""
        return [row.found.get(self.defect) for row in self.rows]

    @property
    def share(self) -> float:
        """Share of the searches that found it."""
        return fmean(one is not None for one in self.flights)

    def __str__(self) -> str:
        """Return the numbers of a cell of the table."""
        return ", ".join("–" if one is None else str(one) for one in self.flights) or "not run"


def page(rows: Sequence[Row], halves: dict[str, str]) -> str:
    """Return the page in Markdown; `halves` says of each defect whether it is for fitting or for reporting."""
    arms = [arm for arm in ARMS if any(row.arm == arm and set(row.faults) <= set(TABLE) for row in rows)]
    tries = {
        arm: [Tries(defect, halves[defect], [row for row in rows if row.arm == arm]) for defect in sorted(TABLE)]
        for arm in arms
    }
    figures = {
        "arms": "\n".join(f"| `{arm}` | {ARMS[arm]} |" for arm in arms),
        "shares": table(
            ("arm", "half", "defects", "tries", "found", "median flights"),
            [line for arm in arms for half in HALVES if (line := share(arm, half, tries[arm]))],
        ),
        "defects": table(
            ("defect", "half", *(f"`{arm}`" for arm in arms)),
            [(f"`{one}`", halves[one], *(str(tries[arm][i]) for arm in arms)) for i, one in enumerate(sorted(TABLE))],
        ),
        "lacking": sum(not one.rows for mine in tries.values() for one in mine),
        "spoke": "\n".join(_spoke(arm, [row for row in rows if row.arm == arm]) for arm in arms),
    }
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(figures)


def share(arm: str, half: str, tries: Sequence[Tries]) -> tuple[object, ...] | None:
    """Return an arm's line of the table for one half of the defects, each counted once; None if none was tried."""
    mine = [one for one in tries if one.half == half and one.rows]
    if not mine:
        return None
    shares = np.array([one.share for one in mine])
    low, high = bootstrap_95(lambda index: float(shares[index].mean()), len(shares), derive(1, "bench search"))
    budget = max(row.budget for one in mine for row in one.rows)
    middle = median(median(budget + 1 if one is None else one for one in each.flights) for each in mine)
    return (
        f"`{arm}`",
        half,
        len(mine),
        sum(len(one.rows) for one in mine),
        f"{shares.mean():.0%} [{low:.0%}, {high:.0%}]",
        f"over {budget}" if middle > budget else f"{middle:g}",
    )


def _spoke(arm: str, rows: Sequence[Row]) -> str:
    judged = sum(row.judged for row in rows)
    applied, spoke = (
        sum(share * row.judged for share, row in zip(shares, rows, strict=True)) / max(1, judged)
        for shares in ([row.applied_share for row in rows], [row.spoke_share for row in rows])
    )
    alarms = sum(sum(row.false_alarms.values()) for row in rows)
    of = " of its own policy" if arm in OF_ONE_POLICY else ""
    return f"| `{arm}` | {len(rows)} | {judged} | {applied:.1%}{of} | {spoke:.0%} | {alarms} |"
