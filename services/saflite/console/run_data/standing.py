"""How a run stands: its campaign's state in one word and in a line, the same wherever it is told."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from saflite.console.run_data.farm_lookup import says_it_runs
from saflite.contract.control import NOT_RUNNING
from saflite.contract.events import CampaignChanged
from saflite.runtime import stop_note

BY_ORDER = "stopped"  # what an operator's order to stop is told with (`campaign/engine/reducer.py`)
NO_END = "no end is known: it was killed, or nobody works on it yet"


class Standing(NamedTuple):
    """The state in one word, and why; `failed`: a part of the farm broke before the budget was flown."""

    state: str
    why: str = ""
    failed: bool = False

    @property
    def text(self) -> str:
        """Both in a line."""
        return f"{self.state}: {self.why}".removesuffix(": ")

    @property
    def is_over(self) -> bool:
        """Whether everything the campaign meant to fly was flown, what makes its finds smaller, too."""
        return self.state == "ended" and self.why != BY_ORDER

    @property
    def broke(self) -> str:
        """What broke before the end, in words; empty if nothing is known to. Nobody notes why a killed run stands."""
        if self.state == NOT_RUNNING and not self.why:
            return NO_END
        return self.why if self.failed else ""

    @property
    def is_unfinished(self) -> bool:
        """Whether it neither ended nor was stopped where somebody had asked for it: it works, or was interrupted."""
        return self.state != "ended" and (self.state != NOT_RUNNING or stop_note.is_signal(self.why))


def standing(run_dir: Path, last: CampaignChanged | None) -> Standing:
    """Return how a run stands whose campaign changed last in this way; none: it never began."""
    if last is not None and last.state == "ended":
        return Standing("ended", last.why, last.failed)
    if not says_it_runs(run_dir):
        note = stop_note.read(run_dir)
        return Standing(NOT_RUNNING, note.removeprefix(stop_note.FAILED), note.startswith(stop_note.FAILED))
    return Standing("") if last is None else Standing(last.state, last.why)


def inputs_told(shown: Standing, *, shrinks: bool) -> str:
    """Return what may be said of the inputs behind a find: that they are the smallest only where they are."""
    if not shrinks:
        return "inputs, not minimised: [search] shrink = true does that"
    return "the smallest inputs found" if shown.is_over else "the smallest inputs so far, minimising is not over"
