"""The flights at the ends of all ranges that `scripts/bench edges --extremes` flies: sound to draw, and not lax."""

from __future__ import annotations

from itertools import islice

import edge_cases
import extreme_cases
import msgspec
import pytest

from saflite.contract.test_case import identity
from saflite.flight.autopilots.described import setting_ranges
from saflite.flight.autopilots.reference.defects import SETTING


def test_one_seed_draws_the_same_flights() -> None:
    first, again, other = ([identity(case) for case in islice(extreme_cases.extremes(seed), 20)] for seed in (1, 1, 2))
    assert first == again
    assert not set(first) & set(other)


def test_what_is_set_lies_within_its_documented_range() -> None:
    ranges = setting_ranges("reference")
    for case in islice(extreme_cases.extremes(3), 60):
        given = [*case.target.parameters.items(), *((one.name, one.values[0]) for one in case.stimuli if one.values)]
        for name, value in given:
            low, high = ranges.get(name, (value, value))
            assert low <= value <= high, name


def test_no_rule_is_broken_in_them_but_by_defects() -> None:
    cases = tuple(islice(extreme_cases.extremes(5), 6))
    assert not any(edge_cases.broken(case) for case in cases)
    defects = ["brake-keeps-speed", "gps-failsafe-without-action", "land-fast"]
    targets = (msgspec.structs.replace(case.target, settings={SETTING: defects}) for case in cases)
    faulty = [msgspec.structs.replace(case, target=target) for case, target in zip(cases, targets, strict=True)]
    assert any(edge_cases.broken(case) for case in faulty)


ONCE = [  # seed, and which of its flights broke a rule that has been mended since
    (1, (7, 20, 46, 117, 122, 154)),
    (21, (6, 18)),
    (22, (65, 78)),
    (23, (128, 162, 175)),
    (25, (34, 147)),
    (26, (199,)),
    (27, (120, 122)),
    (28, (65, 111)),
    (31, (143,)),
    (32, (184,)),
    (33, (179,)),
    (34, (140,)),
    (35, (144,)),
    (61, (143,)),
    (62, (67, 132)),
    (63, (15, 43)),
    (64, (122,)),
]
NEWEST = 8  # flown each time; the others with the live tests


@pytest.mark.parametrize(
    ("rng_seed", "numbers"),
    [pytest.param(*row, marks=() if place < NEWEST else pytest.mark.live) for place, row in enumerate(reversed(ONCE))],
)
def test_what_rules_once_took_for_a_violation_breaks_none(rng_seed: int, numbers: tuple[int, ...]) -> None:
    cases = list(islice(extreme_cases.extremes(rng_seed), max(numbers) + 1))
    assert [number for number in numbers if edge_cases.broken(cases[number])] == []
