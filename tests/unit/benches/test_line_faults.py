"""Changed lines of the reference: whether a flight shows one, and whether a rule sees it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts" / "benches"))
from _blind_faults import Site, sites
from _line_faults import Known, known_flight, line_name, seen_in_lines

from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase


@pytest.fixture(scope="module")
def known() -> Known:
    turn = Stimulus(at_s=3.0, kind="command", name="MAV_CMD_CONDITION_YAW", values=(90.0, 0.0, 1.0, 0.0))
    scenario = Scenario(start=StartState(mode="GUIDED", altitude_m=20.0), time_limit_s=8.0)
    return known_flight(TestCase(target=Target(), scenario=scenario, stimuli=(turn,)))


def place(function: str, text: str) -> Site:
    return next(one for one in sites() if one.function == function and one.text.endswith(text))


def test_an_order_refused_for_nothing_is_seen(known: Known) -> None:
    row = seen_in_lines(place("_yaw", "LtE to Gt"), [known], 3)
    assert row["seen_by"] == ["order-taken"]
    assert row["moved"]["heading_deg"] > 80.0


def test_what_moves_nothing_is_told_as_such(known: Known) -> None:
    row = seen_in_lines(place("_yaw", "Lt to GtE"), [known], 3)  # the sense of relative turns: this one is none
    assert row["reached_in"] == 1
    assert row["moved"] == {}
    assert row["seen_by"] == []


def test_a_function_that_no_flight_reaches_is_told_as_such(known: Known) -> None:
    assert seen_in_lines(place("Flip.run", "Eq to NotEq"), [known], 3)["reached_in"] == 0


def test_no_two_places_share_a_name() -> None:
    names = [(one.module, one.function, line_name(one)) for one in sites()]
    assert len(set(names)) == len(names)
