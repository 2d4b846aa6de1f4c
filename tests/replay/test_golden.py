"""Flights and searches give what they gave when frozen; `scripts/golden --write` freezes today's results.

A search that goes by identities may move when those change on purpose; its twin named free of identities may not.
"""

from __future__ import annotations

import sys

import pytest
from golden import FINDS_FILE, FLIGHTS_FILE, find_differences, flight_differences, fly, load, write
from golden_campaigns import SEARCHES, finds
from golden_cases import FLIGHTS, cases

CASES = cases()


def explained(what: str, differences: list[str]) -> str:
    return "\n  ".join([f"{what} is not what it was (on purpose? scripts/golden --write):", *differences])


def test_nothing_golden_is_missing() -> None:
    assert len(CASES) == FLIGHTS
    assert sorted(load(FLIGHTS_FILE)) == sorted(CASES)
    assert sorted(load(FINDS_FILE)) == sorted(SEARCHES)


def test_the_flights_cover_inputs_modes_and_weather() -> None:
    stimuli = [stimulus for case in CASES.values() for stimulus in case.stimuli]
    assert {stimulus.kind for stimulus in stimuli} == {"parameter", "command", "stick", "mode", "sensor_fault"}
    assert len({stimulus.name for stimulus in stimuli if stimulus.kind == "mode"}) >= 8
    assert any(case.scenario.wind.gust_mps > 0.0 for case in CASES.values())


@pytest.mark.parametrize("name", CASES)
def test_flight_is_the_golden_one(name: str) -> None:
    differences = flight_differences(load(FLIGHTS_FILE)[name], fly(CASES[name]))
    assert not differences, explained(f"flight {name}", differences)


@pytest.mark.golden
@pytest.mark.parametrize("name", SEARCHES)
def test_search_flies_and_finds_the_golden_rows(name: str) -> None:
    differences = find_differences(load(FINDS_FILE)[name], finds(name))
    assert not differences, explained(f"search {name}", differences)


def test_a_moved_flight_names_its_signals() -> None:
    golden = {"ending": "completed", "simulated_s": 1.0, "samples": 2, "digest": "a", "parts": {"x_m": "1", "y_m": "1"}}
    moved = {**golden, "ending": "crashed", "digest": "b", "parts": {"x_m": "2", "z_m": "1"}}
    told = ["ending: golden completed, now crashed", "signals moved: x_m", "signals gone: y_m", "signals added: z_m"]
    assert flight_differences(golden, moved) == told
    assert flight_differences(golden, golden) == []


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: test_golden.py --write (to compare: pytest)")
    write()
