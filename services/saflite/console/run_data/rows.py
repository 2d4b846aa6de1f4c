"""Rows of a run's tables as they are read."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any, NamedTuple

from saflite.contract.blobs import BlobRef
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


FLIGHT: Any = tuple[str, int, Purpose, Ending, float, float, str, str, float | None, str]
ARTEFACT: Any = tuple[str, Purpose, int, str, str, int]
SCORE: Any = tuple[str, str, str, float, int, str, str, str | None]
"""The columns that the rows are made of."""


def flight_row(columns: Sequence[Any]) -> FlightRow:
    """Return a flight; the policies it violated stand in one text."""
    *known, violated = columns
    return FlightRow._make((*known, tuple(filter(None, violated.split(",")))))


class ArtefactRow(NamedTuple):
    """A named file that a flight left behind and the run has kept."""

    test_case: str
    purpose: Purpose
    flight_index: int
    name: str
    blob: BlobRef


def artefact_row(columns: Sequence[Any]) -> ArtefactRow:
    """Return an artefact; digest and size of its blob come last."""
    *known, digest, size_bytes = columns
    return ArtefactRow._make((*known, BlobRef(digest=digest, size_bytes=size_bytes)))


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


def score_row(columns: Sequence[Any]) -> ScoreRow:
    """Return a score; what it violated comes last as text, None where it was not flown."""
    *known, shadow, fault, selected_by, violated = columns
    return ScoreRow._make((*known, bool(shadow), fault, selected_by, None if violated is None else bool(violated)))


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


def in_sum(batches: Iterable[UsageRow]) -> list[UsageRow]:
    """Return what batches in order of their models took, in sum for each: more than SQL can add up."""
    by_model = groupby(batches, key=lambda row: row.model)
    return [UsageRow(model, *map(sum, list(zip(*found, strict=True))[1:])) for model, found in by_model]


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
