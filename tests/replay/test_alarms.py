"""Every false alarm of a search that has its test case kept (rows in `scripts/benches/results`) stays mended."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import TestCase, identity
from saflite.oracle.judge import judge

RESULTS = Path(__file__).parents[2] / "scripts" / "benches" / "results"
FILES = [RESULTS / f"{name}.jsonl" for name in ("clean", "lists-blind", "exposure-fit")]
LINES = [line for path in FILES for line in path.open(encoding="utf-8")]
KEPT = [row for row in map(json.loads, LINES) if row.get("alarm_cases")]
ONCE = {
    identity(msgspec.convert(told, TestCase)): (row["rng_seed"], told, tuple(row["false_alarms"]))
    for row in KEPT
    for told in row["alarm_cases"]
}
NEWEST = 8  # flown each time; the others with the live tests
CASES = [
    pytest.param(told, policies, id=f"{seed}-{name}", marks=() if place < NEWEST else pytest.mark.live)
    for place, (name, (seed, told, policies)) in enumerate(reversed(ONCE.items()))
]


def test_some_are_kept() -> None:
    assert len(CASES) > NEWEST


@pytest.mark.parametrize(("told", "policies"), CASES)
def test_what_was_once_a_false_alarm_breaks_none_of_the_rules_it_broke(
    told: dict[str, object], policies: tuple[str, ...]
) -> None:
    case = msgspec.convert(told, TestCase)
    record = fly_once(case)
    assert record.trace is not None
    flight = Flight(test_case=identity(case), flight_index=0, ending=record.ending, delivered=record.delivered)
    verdicts = judge(case, flight, record.trace, policies).verdicts
    assert [one.policy for one in verdicts if one.outcome == "violated"] == []
