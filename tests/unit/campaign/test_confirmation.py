"""What re-flights make of a violation, and that no more are flown than it takes."""

from __future__ import annotations

from math import comb

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saflite.campaign.lifecycle.confirmation import (
    Broken,
    FlightNote,
    Trial,
    confirmation_of,
    reflights_wanted,
    violations_of,
)
from saflite.campaign.lifecycle.repeats import RepeatRule
from saflite.contract.flight import Flight
from saflite.contract.interval import wilson
from saflite.contract.test_case import Scenario, StartState, Target, TestCase, identity
from saflite.contract.verdict import Judgement, Verdict

CASE = TestCase(target=Target(), scenario=Scenario(start=StartState()))
POLICIES = ("p", "q")

Ends = tuple[frozenset[str] | None, ...]
"""The policies each re-flight would break; None for one that cannot be flown."""


@pytest.mark.parametrize(
    ("reflown", "again", "asked", "needed", "expected"),
    [
        (1, 1, 1, 1, "confirmed"),
        (1, 0, 1, 1, "flaky"),
        (0, 0, 0, 1, "unconfirmed"),
        (0, 0, 1, 1, "unconfirmed"),
        (3, 2, 3, 2, "confirmed"),
        (3, 1, 3, 2, "flaky"),
        (2, 1, 3, 2, "unconfirmed"),  # the third could not be flown and might have failed
        (2, 0, 3, 2, "flaky"),
        (2, 2, 3, 2, "confirmed"),
        (1, 0, 2, 2, "flaky"),  # whatever the second would show
        (1, 1, 1, 2, "unconfirmed"),  # the budget left room for one only
    ],
)
def test_confirmation(reflown: int, again: int, asked: int, needed: int, expected: str) -> None:
    assert confirmation_of(reflown, again, asked, needed) == expected


def _flight(index: int) -> Flight:
    return Flight(test_case=identity(CASE), flight_index=index, ending="completed")


def _trial(broken: frozenset[str], flights: int) -> Trial:
    verdicts = tuple(
        Verdict(policy=one, outcome="violated", robustness=-1.0, severity="soft") for one in sorted(broken)
    )
    judgement = Judgement(test_case=identity(CASE), flight_index=0, verdicts=verdicts)
    trial = Trial(CASE, identity(CASE), 0, 0, confirm_max=flights, judgement=judgement)
    trial.flights[0] = FlightNote(_flight(0), judged=True)
    return trial


def _fly(trial: Trial, ends: Ends) -> None:
    """Fly the next ones asked for, until `trial.asked`."""
    for index in trial.reflights:
        end = ends[index - 1]
        trial.flights[index] = FlightNote(_flight(index), judged=end is not None, given_up=end is None)
        trial.flights[index].violated = {policy: Broken(-1.0, is_hard=False) for policy in end or ()}


def _told(trial: Trial, rule: RepeatRule) -> dict[str, str]:
    return {one.policy: one.confirmation for one in violations_of(trial, rule)}


BREAKS = st.frozensets(st.sampled_from(POLICIES))


@given(
    broken=st.frozensets(st.sampled_from(POLICIES), min_size=1),
    ends=st.lists(st.none() | BREAKS, max_size=7).map(tuple),
    data=st.data(),
)
def test_re_flights_end_when_all_is_decided_and_decide_the_same(
    broken: frozenset[str], ends: Ends, data: st.DataObject
) -> None:
    most = len(ends)
    rule = RepeatRule("bitwise", most, data.draw(st.integers(1, max(1, most))))
    trial, whole = _trial(broken, most), _trial(broken, most)
    while wanted := reflights_wanted(trial, rule.needed):
        undecided = [one for one in broken if rule.decide(_again(trial, one), _judged(trial)) is None]
        assert undecided, "a flight that decides nothing"
        trial.asked += wanted
        assert trial.asked <= most
        _fly(trial, ends)
    whole.asked = most
    _fly(whole, ends)
    early, late = _told(trial, rule), _told(whole, rule)
    assert {one for one in broken if early[one] == "confirmed"} == {one for one in broken if late[one] == "confirmed"}
    if None not in ends:
        assert early == late


def _judged(trial: Trial) -> int:
    return sum(trial.flights[index].judged for index in trial.reflights)


def _again(trial: Trial, policy: str) -> int:
    return sum(policy in trial.flights[index].violated for index in trial.reflights)


@pytest.mark.parametrize(
    ("ends", "flown"),
    [
        ([{"p"}, {"p"}, {"p"}], 2),
        ([set(), set(), {"p"}], 2),
        ([{"p"}, set(), {"p"}], 3),
        ([{"p"}, None, {"p"}], 3),  # one that cannot be flown decides nothing
        ([set(), None, {"p"}], 2),  # and two of three are out of reach
    ],
)
def test_a_third_flight_only_where_two_disagree(ends: list[set[str] | None], flown: int) -> None:
    trial = _trial(frozenset({"p"}), 3)
    while wanted := reflights_wanted(trial, 2):
        trial.asked += wanted
        _fly(trial, tuple(None if one is None else frozenset(one) for one in ends))
    assert trial.asked == flown


def _ends(rule: RepeatRule) -> dict[tuple[int, int], int]:
    """Return how many orders of flights end after so many failures in so many flights."""
    ends: dict[tuple[int, int], int] = {}
    under_way = [(0, 0)]
    while under_way:
        again, flown = under_way.pop()
        if rule.decide(again, flown) is None:
            under_way += [(again + 1, flown + 1), (again, flown + 1)]
        else:
            ends[again, flown] = ends.get((again, flown), 0) + 1
    return ends


@pytest.mark.parametrize("rule", [RepeatRule("bitwise", 3, 2), RepeatRule("statistically", 5, 3)])
def test_to_end_early_makes_the_interval_of_the_rate_no_less_true(rule: RepeatRule) -> None:
    """Wilson's interval is one for as many flights as were planned: here how often it holds the rate, exactly."""

    def least_share(ends: dict[tuple[int, int], int]) -> float:
        shares = []
        for rate in (number / 1000 for number in range(10, 991)):
            held = 0.0
            for (again, flown), orders in ends.items():
                interval = wilson(again, flown)
                assert interval.low is not None
                assert interval.high is not None
                if interval.low <= rate <= interval.high:
                    held += orders * rate**again * (1 - rate) ** (flown - again)
            shares.append(held)
        return min(shares)

    all_flown = {(again, rule.flights): comb(rule.flights, again) for again in range(rule.flights + 1)}
    assert least_share(_ends(rule)) > least_share(all_flown) > 0.82
