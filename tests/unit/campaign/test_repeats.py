"""How many flights tell whether a test case violates again."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saflite.campaign.lifecycle.repeats import RepeatRule, confirm_rule, shrink_flights_max, shrink_rule
from saflite.contract.config import Campaign, SearchConfig, check_campaign
from saflite.contract.errors import Refused
from saflite.contract.target_info import Repeats

RULES = st.integers(1, 9).flatmap(
    lambda flights: st.integers(1, flights).map(lambda needed: RepeatRule("statistically", flights, needed))
)


@given(RULES, st.data())
def test_a_decision_taken_early_is_the_one_all_flights_come_to(rule: RepeatRule, data: st.DataObject) -> None:
    answers = data.draw(st.lists(st.booleans(), min_size=rule.flights, max_size=rule.flights))
    whole = sum(answers) >= rule.needed
    decisions = [rule.decide(sum(answers[:flown]), flown) for flown in range(rule.flights + 1)]
    assert decisions[-1] == whole
    assert all(decision in (None, whole) for decision in decisions)


@pytest.mark.parametrize(("flights", "needed"), [(1, 1), (3, 2), (5, 3), (5, 1), (4, 4)])
def test_no_fewer_flights_can_decide(flights: int, needed: int) -> None:
    rule = RepeatRule("statistically", flights, needed)
    for flown in range(flights):
        for failed in range(flown + 1):
            if rule.decide(failed, flown) is None:
                least = rule.least_to_decide(failed, flown)
                ways = [
                    min(
                        count
                        for count in range(1, flights + 1)
                        if rule.decide(failed + sum(way[:count]), flown + count) is not None
                    )
                    for way in itertools.product((0, 1), repeat=flights)
                ]
                assert least == min(ways)


@pytest.mark.parametrize(
    ("repeats", "flights", "needed", "expected"),
    [
        ("bitwise", None, None, (3, 2)),
        ("bitwise", 1, None, (1, 1)),
        ("bitwise", 0, None, (0, 1)),
        ("bitwise", None, 4, (4, 4)),
        ("statistically", None, None, (5, 3)),
        ("statistically", 4, None, (4, 3)),
        ("statistically", None, 8, (8, 8)),
        ("statistically", None, 2, (5, 2)),
        ("statistically", 10, 7, (10, 7)),
    ],
)
def test_what_the_campaign_leaves_open(
    repeats: Repeats, flights: int | None, needed: int | None, expected: tuple[int, int]
) -> None:
    rule = confirm_rule(SearchConfig(confirm_flights=flights, confirm_needed=needed), repeats)
    assert rule == RepeatRule(repeats, *expected)


def test_one_flight_shows_it_all_only_where_flights_are_bit_equal() -> None:
    bitwise = confirm_rule(SearchConfig(confirm_flights=3, confirm_needed=2), "bitwise")
    assert shrink_rule(bitwise).flights == 1
    chancy = confirm_rule(SearchConfig(), "statistically")
    assert shrink_rule(chancy) == chancy
    assert shrink_flights_max(SearchConfig(), shrink_rule(bitwise), is_first=True) == 60
    assert shrink_flights_max(SearchConfig(), chancy, is_first=True) == 300
    assert shrink_flights_max(SearchConfig(shrink_flights_max=7), chancy, is_first=True) == 7
    assert shrink_flights_max(SearchConfig(), shrink_rule(bitwise), is_first=False) == 30
    assert shrink_flights_max(SearchConfig(shrink_flights_max=7), chancy, is_first=False) == 3


@pytest.mark.parametrize(("flights", "needed"), [(3, 4), (3, 0), (None, 0), (-1, None)])
def test_numbers_that_make_no_sense_are_refused(flights: int | None, needed: int | None) -> None:
    campaign = Campaign(name="c", search=SearchConfig(confirm_flights=flights, confirm_needed=needed))
    with pytest.raises(Refused, match=r"search\.confirm_"):
        check_campaign(campaign, "here")
