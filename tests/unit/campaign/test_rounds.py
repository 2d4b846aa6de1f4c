"""The budget over rounds: never exceeded, spent to the end, planned alike whatever ends first."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from saflite.campaign.scheduling.rounds import Plan, Rounds
from saflite.contract.config import SearchConfig


def planned(search: SearchConfig, budget: int, luck: int, order: int, dry_stretch: int = 0) -> tuple[list[Plan], int]:
    """Run rounds whose costs depend on `luck` and their round, ending in an `order` of their own.

    With a `dry_stretch` some stretches of so many rounds in a row find nothing to fly.
    """
    rounds, shuffle, plans, spent = Rounds(search, budget), random.Random(order), [], 0
    open_rounds: list[int] = []
    while True:
        while rounds.may_plan():
            plan = rounds.next_plan()
            if plan is None:
                break
            round_ = rounds.open(plan)
            round_.phase = "flying"
            plans.append(plan)
            open_rounds.append(round_.number)
        if not open_rounds:
            return plans, spent
        number = open_rounds.pop(shuffle.randrange(len(open_rounds)))
        round_, dice = rounds.under_way[number], random.Random(f"{luck} {number}")
        round_.cost = sum(1 for _ in range(round_.plan.flights) if dice.random() < 0.8)  # else too few candidates
        if dry_stretch and random.Random(f"{luck} stretch {number // dry_stretch}").random() < 0.5:
            round_.cost = 0
        spent += round_.cost
        rounds.close(number)
        assert spent + rounds.outstanding() <= budget


@settings(max_examples=150, deadline=None)
@given(
    budget=st.integers(1, 120),
    flights=st.integers(1, 12),
    lag=st.integers(1, 5),
    luck=st.integers(0, 1000),
    orders=st.tuples(st.integers(0, 1000), st.integers(0, 1000)),
)
def test_every_flight_is_spent_and_none_more_in_any_order_of_ending(
    budget: int, flights: int, lag: int, luck: int, orders: tuple[int, int]
) -> None:
    search = SearchConfig(flights_per_round=flights, lag=lag)
    first, second = (planned(search, budget, luck, order) for order in orders)
    assert first == second
    assert first[1] == budget


@settings(max_examples=150, deadline=None)
@given(
    lag=st.integers(1, 5),
    luck=st.integers(0, 1000),
    dry_stretch=st.integers(1, 9),
    orders=st.tuples(st.integers(0, 1000), st.integers(0, 1000)),
)
def test_how_often_a_strategy_is_asked_in_vain_does_not_depend_on_the_order_of_ending(
    lag: int, luck: int, dry_stretch: int, orders: tuple[int, int]
) -> None:
    search = SearchConfig(flights_per_round=3, lag=lag)
    first, second = (planned(search, 60, luck, order, dry_stretch) for order in orders)
    assert first == second
    assert len(first[0]) < 200
