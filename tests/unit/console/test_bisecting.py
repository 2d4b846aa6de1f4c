"""Bisecting with flaky violations: the right build, with a probability that can be trusted; what is lost apart."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from scipy import stats

from saflite.console.operations import bisecting, chances
from saflite.console.operations.builds import Sample
from saflite.contract.rng import derive
from saflite.contract.verdict import Verdict

LOST = Sample(0, "infra", None, message="does not build")


def flights(rates: Sequence[float | None], rng_seed: int) -> Callable[[int, int], Sample]:
    draws = derive(rng_seed, "flights")

    def fly(at: int, _number: int) -> Sample:
        rate = rates[at]
        if rate is None:
            return LOST
        violated = draws.random() < rate
        return Sample(0, "completed", (Verdict(policy="p", outcome="violated" if violated else "held"),))

    return fly


def search(rates: Sequence[float | None], rng_seed: int = 1, most: int = 400) -> bisecting.Bisected:
    return bisecting.search(flights(rates, rng_seed), "p", len(rates), confidence=0.95, most=most)


@pytest.mark.parametrize(
    ("rates", "change", "place"),
    [
        ([0.0, 0.0, 0.0, 1.0, 1.0], "broke", 3),
        ([1.0, 1.0, 0.0], "fixed", 2),
        ([0.0, 0.0, 0.0], "never", 0),
        ([1.0, 1.0, 1.0], "always", 0),
        ([0.0, 1.0], "broke", 1),
    ],
)
def test_a_sure_violation_is_placed(rates: list[float | None], change: str, place: int) -> None:
    found = search(rates)
    assert (found.change, found.place, found.sure) == (change, place, True)
    assert found.flights < 30


def test_a_flaky_violation_is_placed_as_often_as_promised() -> None:
    right = 0
    for rng_seed in range(40):
        place = 1 + rng_seed % 7
        found = search([0.0] * place + [0.4] * (8 - place), rng_seed)
        right += found.sure and (found.change, found.place) == ("broke", place)
    assert right >= 34, "0.95 was promised; 33 or fewer of 40 has a chance below 1 in 100 then"
    assert stats.binom.cdf(33, 40, 0.95) < 0.01


def test_builds_that_do_not_fly_are_left_out_and_named() -> None:
    found = search([0.0, None, None, 1.0, 1.0])
    assert (found.change, found.place, found.before, found.between) == ("broke", 3, 0, [1, 2])
    assert set(found.left_out) == {1, 2}
    assert sum(found.lost) <= 4


def test_with_nothing_flown_nothing_is_said() -> None:
    found = search([None, None])
    assert not found.sure
    assert bisecting.exit_code(found) == 3


def test_too_few_flights_are_no_answer() -> None:
    found = search([0.0, 0.0, 0.0, 0.2, 0.2, 0.2], most=3)
    assert (found.sure, found.flights) == (False, 3)


@pytest.mark.parametrize(("here", "there"), [((5, 5), (0, 5)), ((1, 4), (1, 3)), ((0, 0), (0, 0)), ((2, 9), (5, 7))])
def test_the_chance_of_a_greater_rate_is_the_integral(here: chances.Count, there: chances.Count) -> None:
    draws = derive(3, "beta")
    first = draws.beta(1 + here[0], 1 + here[1] - here[0], 200_000)
    second = draws.beta(1 + there[0], 1 + there[1] - there[0], 200_000)
    assert chances.chance_greater(here, there) == pytest.approx((first > second).mean(), abs=0.01)


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
@pytest.mark.parametrize("times", [2, 5, 10, 20])
def test_equal_rates_are_told_apart_about_as_often_as_the_confidence_leaves(times: int, confidence: float) -> None:
    """What the summary of `diff` says of chance: worked out over all outcomes, at the worst rate there is."""
    counts = range(times + 1)
    told = [
        (here, there)
        for here in counts
        for there in counts
        if chances.chance_greater((here, times), (there, times)) >= confidence
    ]
    outcomes = {rate: stats.binom.pmf(counts, times, rate) for rate in (one / 50 for one in range(1, 50))}
    worst = max(sum(chance[here] * chance[there] for here, there in told) for chance in outcomes.values())
    assert worst <= 1.4 * (1.0 - confidence)
