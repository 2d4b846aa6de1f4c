"""The bandit gives more to the better arm, follows when another becomes the better one, and never forgets to try."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from saflite.contract.rng import derive
from saflite.mutator.bandit import Bandit

ROUND, LAG = 8, 3
Rates = dict[str, tuple[float, float]]
"""By arm: the chance of a find in one flight, and what a flight costs."""


def played(bandit: Bandit, rates: Rates, rounds: int, seed: int) -> Counter[str]:
    """Return how often each arm was chosen in the second half of so many rounds, results coming some rounds late."""
    chosen, late = Counter[str](), list[dict[str, int]]()
    for number in range(rounds):
        rng = derive(seed, "round", number)
        shares = bandit.shares(rng, ROUND)
        assert sum(shares.values()) == ROUND
        late.append(shares)
        if number >= rounds // 2:
            chosen.update(shares)
        for arm, many in (late.pop(0) if len(late) > LAG else {}).items():
            for _ in range(many):
                bandit.tell(arm, float(rng.random() < rates[arm][0]), rates[arm][1])
    return chosen


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.floats(0.15, 0.9), st.floats(0.0, 0.25), st.booleans(), st.integers(0, 10**6))
def test_the_better_of_two_arms_gets_more(good: float, worse: float, first: bool, seed: int) -> None:
    rates: Rates = {"good": (good, 100.0), "bad": (good * worse, 100.0)}
    names = ["good", "bad"] if first else ["bad", "good"]
    chosen = played(Bandit(names, 200.0), rates, 80, seed)
    assert chosen["good"] > 1.5 * chosen["bad"]


def test_of_two_that_find_alike_the_cheaper_gets_more() -> None:
    rates: Rates = {"slow": (0.4, 300.0), "quick": (0.4, 60.0)}
    chosen = played(Bandit(list(rates), 200.0), rates, 80, 1)
    assert chosen["quick"] > 2 * chosen["slow"]


def test_it_follows_when_another_arm_becomes_the_better_one() -> None:
    bandit = Bandit(["a", "b"], 60.0)
    before = played(bandit, {"a": (0.5, 100.0), "b": (0.05, 100.0)}, 60, 2)
    after = played(bandit, {"a": (0.02, 100.0), "b": (0.5, 100.0)}, 80, 3)
    assert before["a"] > 2 * before["b"]
    assert after["b"] > 2 * after["a"]


def test_without_any_find_and_before_any_flight_all_arms_are_tried() -> None:
    bandit = Bandit(["a", "b", "c"], 100.0)
    assert min(bandit.shares(derive(1, "first"), 300).values()) > 70
    for _ in range(100):
        for arm in "abc":
            bandit.tell(arm, 0.0, 100.0)
    assert min(bandit.shares(derive(1, "later"), 300).values()) > 70
