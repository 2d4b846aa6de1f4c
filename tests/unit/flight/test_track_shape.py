"""Shapes of tracks: detours count, time and length do not."""

from __future__ import annotations

import pytest

from saflite.flight.track_shape import gap_m, shape_of


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
