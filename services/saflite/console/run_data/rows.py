"""Rows of a run's tables as they are read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from saflite.contract import wire
from saflite.contract.blobs import BlobRef
from saflite.contract.errors import Refused
from saflite.contract.flight import UNTOLD, Ending, Purpose
from saflite.contract.verdict import Violation


class FlightRow(NamedTuple):
    """One flight as the books counted it. `robustness` None: not judged, or nothing could be said."""

    test_case: str
    flight_index: int
    purpose: Purpose
    ending: Ending
    simulated_s: float
    wall_s: float
    trace_digest: str
    worker: str
    robustness: float | None
    violated: tuple[str, ...]

    def shows(self, violation: Violation) -> bool:
        """Whether it is the flight that shows a violation: no re-flight, check, or flight of a smaller one tried."""
        same = self.test_case == violation.test_case and self.flight_index == violation.flight_index
        return same and self.purpose not in UNTOLD


def flight_row(columns: Sequence[object]) -> FlightRow:
    """Return a flight as the tables have it, in the order of its fields, the policies it violated in one text.

    Raises Refused for what no flight is: SQLite keeps any value in any column, and others may have made the store.
    """
    *known, violated = columns
    try:
        return wire.convert((*known, [word for word in str(violated).split(",") if word]), FlightRow)
    except msgspec.ValidationError as fault:
        raise Refused("books", expected="rows of flights", got=f"{fault}; the tables are damaged") from fault


class ArtefactRow(NamedTuple):
    """A named file that a flight left behind and the run has kept."""

    test_case: str
    purpose: Purpose
    flight_index: int
    name: str
    blob: BlobRef


class ScoreRow(NamedTuple):
    """A score and what came of the test case: `violated` None where its round did not fly it."""

    test_case: str
    model: str
    scored_by: str
    value: float
    shadow: bool
    fault: str
    selected_by: str
    violated: bool | None


class UsageRow(NamedTuple):
    """What the calls of one model took in sum."""

    model: str
    batches: int
    calls: int
    tokens_in: int
    tokens_out: int
    latency_s: float
    cost_usd: float
    asked_again: int
    cached: int
    faults: int


class Fallbacks(NamedTuple):
    """How many scores the embedded scorer gave in place of the one asked, how many nobody, and why it was so last."""

    embedded: int = 0
    unscored: int = 0
    why: str = ""

    def in_words(self, of_whom: str = "") -> str:
        """Return it in words, empty where every score was given by the scorer asked."""
        told = f"{self.embedded} scores by the embedded scorer instead{of_whom}" if self.embedded else ""
        cases = "1 test case was" if self.unscored == 1 else f"{self.unscored} test cases were"
        lost = f"{cases} not scored" if self.unscored else ""
        both = ", ".join(filter(None, (told, lost)))
        return f"{both}: {self.why}" if both and self.why else both


NO_FALLBACKS = Fallbacks()
