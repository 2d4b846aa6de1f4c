"""Every planted defect is caught by its policy through its shortest trigger; without the defect nothing is violated."""

from __future__ import annotations

import pytest

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.test_case import TestCase, identity
from saflite.flight.autopilots.reference.defects import DEFECTS, TABLE, trigger
from saflite.oracle.judge import judge
from saflite.oracle.policy import load_policy, policy_names


def violated(test_case: TestCase) -> set[str]:
    record = fly_once(test_case)
    names = tuple(name for name in policy_names() if "reference" not in load_policy(name).file.not_checked_on)
    flight = Flight(test_case=identity(test_case), flight_index=0, ending=record.ending, delivered=record.delivered)
    judgement = judge(test_case, flight, record.trace, names)
    return {verdict.policy for verdict in judgement.verdicts if verdict.outcome == "violated"}


@pytest.mark.parametrize("name", sorted(TABLE))
def test_trigger_breaks_the_policy_only_with_the_defect(name: str) -> None:
    assert TABLE[name].policy in violated(trigger(name))
    assert violated(trigger(name, planted=False)) == set()


def test_the_bugs_of_the_paper_are_there() -> None:
    bugs = {defect.bug for defect in TABLE.values()}
    assert {"3", "23, first case", "23, second case", "24", "25", "133", "134", "135"} <= bugs
    assert {"reposition-in-hold", "parachute-in-acro"} <= set(DEFECTS)
    assert len(DEFECTS) >= 20
