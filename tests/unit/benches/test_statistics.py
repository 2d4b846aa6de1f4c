"""What the measurements make of their rows: pairs, corrections, every defect counted once."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "scripts" / "benches"))
from _bootstrap import bootstrap_95
from _paired import compare, holm
from _search_page import Tries, share
from _search_run import Row
from reach import found_after

from saflite.contract.rng import derive


def test_pairs_are_compared_one_by_one() -> None:
    first, second = [5.0, 7.0, 6.0, 9.0, 8.0, 7.0, 9.0], [3.0, 7.0, 5.0, 5.0, 3.0, 4.0, 3.0]
    found = compare(first, second, derive(1, "pairs"))
    assert found.pairs == 7
    assert found.difference == pytest.approx(3.0)
    assert found.low < 3.0 < found.high
    assert found.effect == 1.0, "never worse"
    assert found.p == pytest.approx(2 / 2**6), "six pairs that differ, all one way"
    # differences 2 0 1 4 5 3 6: standard deviation sqrt(28 / 6)
    assert found.detectable == pytest.approx(2.8 * math.sqrt(28 / 6 / 7))


def test_equal_arms_differ_in_nothing() -> None:
    found = compare([1.0, 2.0], [1.0, 2.0], derive(1, "pairs"))
    assert (found.difference, found.p, found.effect) == (0.0, 1.0, 0.0)


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_pairs_say_nothing(count: int) -> None:
    found = compare([3.0] * count, [1.0] * count, derive(1, "pairs"))
    assert found.pairs == count
    assert np.isnan(found.p)
    assert np.isnan(found.detectable)


def test_p_values_are_corrected_for_their_number() -> None:
    corrected = holm([0.01, float("nan"), 0.04, 0.03])
    assert corrected[0] == pytest.approx(0.03)
    assert np.isnan(corrected[1])
    assert corrected[2:] == pytest.approx([0.06, 0.06]), "never below one that ranks before"


def searched(defect: str, *flights: int | None) -> Tries:
    rows = [
        Row(
            arm="own",
            faults=(defect,),
            rng_seed=number,
            budget=100,
            flights=100,
            found=found,
            by_policy={},
            false_alarms={},
            judged=100,
            applied_share=0.0,
            spoke_share=0.0,
            silent=[],
            states=0,
            wall_s=0.0,
        )
        for number, flown in enumerate(flights)
        for found in [{} if flown is None else {defect: flown}]
    ]
    return Tries(defect, "fit", rows)


def test_every_defect_counts_once_and_unfinished_searches_count() -> None:
    easy, hard, never = (
        searched("easy", 1, 1, 1, 1, 1, 1),
        searched("hard", 50, None, 70),
        searched("never", None, None),
    )
    line = share("own", "fit", [easy, hard, never])
    assert line is not None
    assert line[2:4] == (3, 11), "defects and tries"
    assert str(line[4]).startswith("56% ["), "the mean of 1, 2/3 and 0"
    assert line[5] == "70"
    assert share("own", "fit", [hard, never, never])[5] == "over 100"  # type: ignore[index]
    assert share("own", "report", [easy]) is None, "nothing of that half was tried"


def test_draws_without_a_value_do_not_take_the_interval_away() -> None:
    failed = np.array([True, False, False, False])

    def share_of_failed(index: np.ndarray) -> float:
        return float(index[failed[index]].size / index.size) if failed[index].any() else math.nan

    low, high = bootstrap_95(share_of_failed, 4, derive(1, "draws"))
    assert 0.25 <= low < high <= 1.0
    assert all(math.isnan(bound) for bound in bootstrap_95(lambda _: math.nan, 4, derive(1, "none")))


def test_what_is_found_after_some_of_the_flights_is_the_mean_over_all_ways_to_draw_them() -> None:
    rows = [{"cases": 4, "seen": seen} for seen in (0, 1, 4)]
    assert found_after(2, rows, "seen") == pytest.approx(0.0 + 0.5 + 1.0)
    assert found_after(4, rows, "seen") == 2.0
