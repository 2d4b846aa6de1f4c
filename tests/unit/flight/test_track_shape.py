"""Shapes of tracks: detours count, time and length do not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from saflite.contract.rng import derive
from saflite.flight.track_shape import first_like, gap_m, shape_of


def track(points: list[tuple[float, float]], step_s: float = 1.0) -> tuple[tuple[float, float, float, float], ...]:
    """A track through places."""
    return tuple((step_s * number, x_m, y_m, 10.0) for number, (x_m, y_m) in enumerate(points))


STRAIGHT = [(0.0, float(y)) for y in range(0, 51, 5)]


def test_the_same_way_flown_slower_or_with_a_stop_is_one_shape() -> None:
    waiting = [*STRAIGHT[:5], *[STRAIGHT[5]] * 40, *STRAIGHT[6:]]
    assert gap_m(shape_of(track(STRAIGHT)), shape_of(track(waiting, 3.0))) == pytest.approx(0.0, abs=1e-9)


def test_the_gap_of_a_way_beside_is_how_far_off_it_leads_and_of_a_detour_less() -> None:
    straight = shape_of(track(STRAIGHT))
    beside = shape_of(track([(8.0, y) for _, y in STRAIGHT]))
    detour = shape_of(track([(8.0 if 20 <= y <= 30 else x, y) for x, y in STRAIGHT]))
    assert gap_m(straight, beside) == pytest.approx(8.0)
    assert 1.0 < gap_m(straight, detour) < 4.0
    assert gap_m(detour, straight) == pytest.approx(gap_m(straight, detour))


def test_two_flights_without_a_track_are_alike_and_like_no_other() -> None:
    assert gap_m(shape_of(()), shape_of(())) == 0.0
    assert gap_m(shape_of(()), shape_of(track(STRAIGHT))) == float("inf")


def best_alignment_m(one: bytes, other: bytes) -> float:
    """The definition, place by place: the least sum, of these the one in least steps, over its steps."""
    ours, theirs = (np.frombuffer(shape).reshape(-1, 2).tolist() for shape in (one, other))
    best: dict[tuple[int, int], tuple[float, int]] = {(-1, -1): (0.0, 0)}
    for i, place in enumerate(ours):
        for j, there in enumerate(theirs):
            total, steps = min(best[key] for key in ((i - 1, j - 1), (i - 1, j), (i, j - 1)) if key in best)
            best[i, j] = total + math.sqrt((place[0] - there[0]) ** 2 + (place[1] - there[1]) ** 2), steps + 1
        best.pop((-1, -1), None)
    total, steps = best[len(ours) - 1, len(theirs) - 1]
    return total / steps


def wandering(number: int, scale_m: float) -> bytes:
    places = np.cumsum(derive(1, "wandering", number).normal(0.0, scale_m, (90, 2)), axis=0)
    return shape_of(track([(float(x), float(y)) for x, y in places]))


def test_the_gap_is_that_of_the_best_alignment_and_the_first_like_one_is_found() -> None:
    shapes = [wandering(number, (0.3, 1.0, 2.5)[number % 3]) for number in range(12)]
    for place, shape in enumerate(shapes[:3]):
        gaps_m = [best_alignment_m(shape, other) for other in shapes]
        assert [gap_m(shape, other) for other in shapes] == gaps_m
        for limit_m in (0.0, 3.0, 8.0, 30.0):
            first = next((number for number, gap in enumerate(gaps_m) if gap <= limit_m), None)
            assert first_like(shape, shapes, limit_m) == first, (place, limit_m)
    assert first_like(shapes[0], [b"", shapes[0]]) == 1
    assert first_like(b"", [shapes[0], b""]) == 1
