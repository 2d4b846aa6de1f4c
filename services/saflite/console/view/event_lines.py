"""Every event in one line: when, which, what."""

from __future__ import annotations

from datetime import UTC, datetime

from saflite.console.run_data.rows import Fallbacks
from saflite.console.view import live
from saflite.contract.events import (
    BudgetChanged,
    CampaignChanged,
    Event,
    Fact,
    Flown,
    Judged,
    Proposed,
    Scored,
    ViolationFound,
    WorkerChanged,
)
from saflite.contract.plain import some, word
from saflite.contract.verdict import NEVER_APPLIED

NAMES_SHOWN = 3


def event_line(event: Event) -> str:
    """Return an event in one line: its number, when it was in UTC, and what."""
    return f"{event.seq:6d}  {_when(event.at_unix_s)}  {word(_text(event.fact))}"


def _when(at_unix_s: float) -> str:
    try:
        return f"{datetime.fromtimestamp(at_unix_s, UTC):%Y-%m-%d %H:%M:%S}Z"
    except (ValueError, OverflowError, OSError):  # books of others may tell of any time
        return f"{at_unix_s:.0f} s"


def _text(fact: Fact) -> str:
    match fact:
        case ViolationFound():
            return live.violation_line(fact.violation)
        case CampaignChanged():
            return f"campaign  {fact.state}" + (f": {fact.why}" if fact.why else "")
        case Proposed():
            return (
                f"proposed  round {fact.round}: {_counted(len(fact.test_cases))}: {some(fact.test_cases, NAMES_SHOWN)}"
            )
        case Scored():
            return _scored(fact)
        case Flown():
            return (
                f"flown  {fact.test_case}/{fact.flight_index} {fact.ending} {fact.simulated_s:.0f} s by {fact.worker}"
            )
        case Judged():
            return f"judged  {fact.test_case}/{fact.flight_index} {_said(fact)} {' '.join(fact.violated)}".rstrip()
        case BudgetChanged():
            return f"budget  {fact.budget} flights, {fact.previous} before"
        case WorkerChanged():
            return _change(fact)
        case _:
            return live.fact_text(fact)


def _counted(count: int) -> str:
    return f"{count} test case{'' if count == 1 else 's'}"


def _scored(fact: Scored) -> str:
    told = f"scored  round {fact.round}: {_counted(len(fact.scores))} by {fact.model} in {fact.latency_s:.2f} s"
    if fact.scores:
        values = [value for _, value in fact.scores]
        best = max(fact.scores, key=lambda pair: pair[1])[0]
        told += f", {min(values):.2f} to {max(values):.2f}, highest {best}"
    instead = Fallbacks(fact.fallbacks - fact.unscored, fact.unscored).in_words()
    return f"{told}, {instead}" if instead else told


def _change(fact: WorkerChanged) -> str:
    if not fact.present:
        return f"left  {fact.worker} ({fact.stage}): {fact.message}"
    build = f", build {fact.build[:12]}" if fact.build else ""
    return f"joined  {fact.worker} ({fact.stage}) on {fact.host}{build}"


def _said(fact: Judged) -> str:
    if fact.robustness is not None:
        return f"{fact.robustness:+.2f}"
    return f"vacuous: {NEVER_APPLIED}" if fact.vacuous else "inconclusive"
