"""The whole farm under faults, and proof that the checks see what they claim to see.

`scripts/farm --seeds 3000` runs more; `scripts/farm --seed 17` runs one seed again.
"""

from __future__ import annotations

import logging
from typing import Any, get_args

import pytest
from farm_bugs import BUGS, _patched, is_stale, never_ran
from farm_members import StrategyEnds
from farm_shapes import CALM, clean, shape_of
from farm_world import World, know_the_clean_finds, run_seed

from saflite.campaign.engine.state import Books

SEEDS, CHUNKS = 64, 8
BUG_SEEDS_MAX = 80
LIKELY = {
    "anybody_may_ask": 9,
    "anybody_may_report": 1,
    "chosen_by_order_of_arrival": 5,
    "every_flight_counts_as_a_repeat": 1,
    "leases_are_forgotten_over_a_restart": 1,
    "old_test_cases_fly_again": 7,
    "one_flight_of_a_smaller_test_case_is_remembered_as_truth": 12,
    "outcomes_in_order_of_arrival": 5,
    "planned_on_what_happens_to_be_known": 27,
    "the_mutator_is_told_too_early": 3,
}
"""Where a bug was seen first; only saves time."""


@pytest.fixture(autouse=True)
def _quiet() -> object:
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize("chunk", [pytest.param(n, marks=pytest.mark.live if n % 2 else ()) for n in range(CHUNKS)])
def test_nothing_is_lost_or_counted_twice_whatever_happens(chunk: int) -> None:
    for seed in range(chunk, SEEDS, CHUNKS):
        try:
            run_seed(seed)
        except AssertionError as fault:
            pytest.fail(f"seed {seed}: {fault}\nreplay: scripts/farm --seed {seed}")


def test_faults_of_every_kind_really_happen() -> None:
    world = World(8, shape_of(8)._replace(chaos_per_s=2.0))
    report = world.run()
    assert report.faults > 100
    assert world.books.restarts > 0
    assert world.network.lost > 0
    assert world.network.cut > 0
    assert world.ghost.faults


def test_any_number_of_workers_finds_the_same() -> None:
    shape = clean(shape_of(4))
    found = [World(seed, shape._replace(simulators=seed)).run().found for seed in (1, 2, 3, 6)]
    assert found[0]
    assert found == [found[0]] * 4


def test_late_messages_change_nothing() -> None:
    shape = clean(shape_of(3))
    late = shape._replace(trouble=CALM._replace(delay_max_s=1.5, duplicate=0.3))
    assert World(1, shape).run().found == World(2, late).run().found


@pytest.mark.parametrize("ends", [ends for ends in get_args(StrategyEnds) if ends])
def test_what_was_chosen_before_a_strategy_ends_is_flown_by_any_number_of_workers(ends: StrategyEnds) -> None:
    shape = clean(shape_of(4))._replace(strategy_ends=ends, budget=30)
    late = shape._replace(trouble=CALM._replace(delay_max_s=1.5, duplicate=0.3))
    runs = [World(seed, shape._replace(simulators=seed)).run() for seed in (1, 2, 3, 6)] + [World(7, late).run()]
    (first, *others) = [(run.flights, run.found) for run in runs]
    assert first[1]
    assert 0 < first[0] < shape.budget
    assert others == [first] * len(others)


SLOW = (
    "attempts_without_end",
    "a_lost_batch_is_forgotten",
    "leases_never_end",
)
"""Take ten seconds and more each to be caught: flown with the live tests."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.live if name in SLOW else ()) for name in sorted(BUGS)]
)
def test_a_planted_bug_is_caught(name: str) -> None:
    know_the_clean_finds()
    with BUGS[name]():
        for seed in (LIKELY.get(name, 0), *range(BUG_SEEDS_MAX)):
            if _is_caught(seed):
                assert not never_ran(), f"caught before the planted code ran: {never_ran()} of {name} is stale"
                return
    pytest.fail(f"{name} got through {BUG_SEEDS_MAX} seeds")


def test_a_planted_bug_that_no_longer_fits_the_code_is_no_catch() -> None:
    with pytest.raises(AssertionError, match="stale"), _patched(Books, "ask", lambda self: None):
        pass

    def calls_what_is_gone(self: Any, ask: Any, now: float) -> Any:
        return self.a_method_of_last_year(ask, now)

    with _patched(Books, "ask", calls_what_is_gone), pytest.raises(AttributeError) as fault:
        run_seed(0)
    assert is_stale(fault.value, __file__)
    assert not is_stale(fault.value)  # a mistake that lies elsewhere is what the planted bug did


def test_planted_code_that_nothing_calls_is_noticed() -> None:
    def like_ended(self: Books) -> bool:
        return False

    with _patched(Books, "target", property(like_ended)):
        assert never_ran() == ["target"]
        assert not Books.target.fget(None)  # type: ignore[attr-defined]
        assert never_ran() == []


def _is_caught(seed: int) -> bool:
    try:
        run_seed(seed)
    except Exception as fault:
        if is_stale(fault):
            raise
        return True  # whatever a broken farm does is a catch
    return False
