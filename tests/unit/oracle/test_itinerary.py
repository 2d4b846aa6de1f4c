"""Which mission item has to follow which, and what it asks for: from the mission and the index at each moment."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.contract.flight import Flight, Trace
from saflite.contract.signals import MODES
from saflite.contract.test_case import Mission, MissionItem, Scenario, Target, TestCase
from saflite.oracle import itinerary
from saflite.oracle.signals import FlightSignals

UP, POINT, STAYS, LAND, JUMP, DELAY, TURN, SPEED = 22, 16, 17, 21, 177, 112, 115, 178


def mission(*rows: tuple[float, ...]) -> Mission:
    items = tuple(MissionItem(command=int(row[0]), params=(*row[1:], *[0.0] * 7)[:7]) for row in rows)
    return Mission(name="m", home_lat_deg=47.0, home_lon_deg=8.0, home_alt_m=0.0, items=items)


def place(north_deg: float, hold_s: float = 0.0) -> tuple[float, ...]:
    return (POINT, hold_s, 0.0, 0.0, 0.0, 47.0 + north_deg, 8.0, 10.0)


ROUND = mission((UP, 0, 0, 0, 0, 47.0, 8.0, 10.0), place(1e-3), place(2e-3), (JUMP, 2, 1), place(3e-3), (DELAY, 5))


def wrong(index: list[int], *, modes: list[str] | None = None, started_s: list[float] | None = None) -> list[int]:
    item = np.repeat(np.array(index, dtype=np.float64), 2)
    mode = np.repeat(np.array([MODES[name] for name in modes or ["AUTO"] * len(index)]), 2)
    items = itinerary.items_of(ROUND)
    far = [np.full(len(item), 500.0 if np.isfinite(one.x_m) else np.nan, dtype=np.float64) for one in items]
    flags = itinerary.unexpected(items, item, mode, far, started_s or [], np.arange(len(item), dtype=np.float64))
    return [int(one) // 2 for one in np.flatnonzero(flags)]


@pytest.mark.parametrize(
    ("index", "at"),
    [
        ([0, 1, 2, 3, 1, 2, 3, 4, 5], []),
        ([0, 1, 2, 1, 2, 4, 5], []),  # the jump itself does not show
        ([0, 1, 2, 3, 4, 5], [4]),  # the jump is not taken
        ([0, 1, 2, 3, 1, 2, 3, 1], [7]),  # taken twice
        ([0, 2, 3], [1]),  # skipped
        ([0, 1, 0], [2]),  # gone back
    ],
)
def test_an_item_that_need_not_follow_is_told(index: list[int], at: list[int]) -> None:
    assert wrong(index) == at


def test_a_mission_begun_anew_or_entered_again_counts_afresh() -> None:
    assert wrong([3, 1, 2, 0, 1], started_s=[6.0]) == []
    assert wrong([3, 1, 2, 0, 1]) == [3]
    assert wrong([0, 1, 2, 4, 5], started_s=[6.0]) == [3], "it begins with its first item"
    modes = ["AUTO", "AUTO", "GUIDED", "GUIDED", "AUTO", "AUTO"]
    assert wrong([0, 1, 1, 4, 4, 5], modes=modes) == []
    assert wrong([0, 1, 1, 1, 0, 1], modes=modes, started_s=[8.0]) == []
    assert wrong([0, 1, 2, 2, 2, 3], modes=modes, started_s=[8.0]) == [4], "entered by the order, with its first item"


def test_jumps_among_items_that_are_over_at_once_need_not_show() -> None:
    loop = mission((UP, 0, 0, 0, 0, 47.0, 8.0, 10.0), (SPEED, 1, 6), (JUMP, 2, 2), (115, 340.0), place(1e-3))
    items = itinerary.items_of(loop)
    item, mode = np.array([0.0, 0.0, 1.0, 1.0, 4.0, 4.0]), np.full(6, MODES["AUTO"], dtype=np.float64)
    off = [np.full(6, 500.0 if np.isfinite(one.x_m) else np.nan, dtype=np.float64) for one in items]
    flags = itinerary.unexpected(items, item, mode, off, [], np.arange(6, dtype=np.float64))
    assert not flags.any()


@pytest.mark.parametrize(
    "loop",
    [
        [(DELAY, 2), (JUMP, 2, 2)],  # to the item just before
        [(JUMP, 2, 2), (DELAY, 2), (JUMP, 2, 2)],  # to one that is over at once, and leads there
    ],
)
def test_a_jump_that_leads_to_the_item_before_it_need_not_show_nor_be_counted(loop: list[tuple[float, ...]]) -> None:
    waits = mission((UP, 0, 0, 0, 0, 47.0, 8.0, 10.0), *loop, place(1e-3))
    items, last = itinerary.items_of(waits), float(len(loop))
    rounds = np.array([0.0, last - 1, last - 1, last, last + 1, last + 1])
    off = [np.full(6, 500.0 if np.isfinite(one.x_m) else np.nan, dtype=np.float64) for one in items]
    mode, times = np.full(6, MODES["AUTO"], dtype=np.float64), np.arange(6, dtype=np.float64)
    assert not itinerary.unexpected(items, rounds, mode, off, [], times).any()


def test_where_a_mission_lands() -> None:
    lands = mission(place(1e-3), (LAND, 0, 0, 0, 0, 47.001, 8.0, 0.0), (LAND, 0, 0, 0, 0, 0.0, 0.0, 0.0))
    places = itinerary.landings_of(lands)
    off = itinerary.off(places, np.array([0.0, 1.0, 2.0]), np.zeros(3), np.zeros(3))
    assert off.tolist() == [itinerary.NO_PLACE_M, pytest.approx(111.2, abs=0.5), itinerary.NO_PLACE_M]
    assert itinerary.landings_of(None) == ()


def test_what_the_item_at_hand_asks_for() -> None:
    items = itinerary.items_of(mission(place(1e-3, 4.0), (DELAY, 5), (SPEED, 1, 3)))
    item = np.array([0.0, 1.0, 2.0, 7.0])
    assert np.nan_to_num(itinerary.of_items([one.wait_s for one in items], item)).tolist() == [4.0, 5.0, 0.0, 0.0]
    off = itinerary.off(items, item, np.zeros(4), np.zeros(4))
    assert off[0] == pytest.approx(111.2, abs=0.5)
    assert off[1:].tolist() == [itinerary.NO_PLACE_M] * 3
    height = itinerary.height_off(items, item, np.full(4, 4.0))
    assert height.tolist() == [6.0, *[itinerary.NO_PLACE_M] * 3]


def test_a_wait_right_after_a_turn_asks_for_its_heading() -> None:
    turns = mission((UP, 0), (TURN, 90.0), (DELAY, 5), (TURN, 30.0, 0, -1, 1), (DELAY, 5), (TURN, 10.0), place(1e-3))
    item = np.array([0.0, 1.0, 2.0, 2.0, 3.0, 4.0, 4.0, 5.0, 6.0])
    yaw = np.array([0.0, 0.0, 0.0, 90.0, 90.0, 80.0, 60.0, 0.0, 0.0])
    none = itinerary.NO_HEADING_DEG
    assert itinerary.headings(turns, item, yaw).tolist() == [none, none, 90.0, 90.0, none, 50.0, 50.0, none, none]
    assert itinerary.headings(None, item, yaw).tolist() == [none] * 9
    assert itinerary.commands_of(turns)[:3] == (22.0, 115.0, 112.0)


def test_who_is_to_stay_for_ever_waits_for_ever() -> None:
    here = (STAYS, 0, 0, 0, 0, 0, 0, 10.0)  # without a place, with one before that is known or not
    items = itinerary.items_of(mission((STAYS, 0, 0, 0, 0, 47.001, 8.0, 10.0), here, (JUMP, 2, 1), here))
    assert [items[at].wait_s for at in (0, 1, 3)] == [itinerary.FOR_EVER_S] * 3
    assert (items[1].x_m, np.isnan(items[3].x_m)) == (items[0].x_m, True)


def test_the_speed_ordered_before_an_item_is_told_and_a_jump_leaves_it_open() -> None:
    rows: list[tuple[float, ...]] = [
        (UP, 0, 0, 0, 0, 47.0, 8.0, 10.0), (SPEED, 1, 0.6), place(1e-3), (SPEED, 2, 3), (SPEED, 0, 4), place(2e-3),
    ]  # fmt: skip
    item = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 9.0])
    assert itinerary.speeds(mission(*rows), item).tolist() == [-1.0, -1.0, 0.6, 0.6, 0.6, 4.0, -1.0]
    assert set(itinerary.speeds(mission(*rows, (JUMP, 1, 1)), item).tolist()) == {-1.0}
    assert set(itinerary.speeds(None, item).tolist()) == {-1.0}


def test_a_way_point_without_a_place_is_where_the_one_before_it_was() -> None:
    here = (POINT, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 15.0)
    up = (UP, 0, 0, 0, 0, 47.0, 8.0, 10.0)
    items = itinerary.items_of(mission(up, here, place(1e-3), here, (JUMP, 2, 1), here))
    places = [(round(one.x_m), one.altitude_m) if np.isfinite(one.x_m) else None for one in items]
    assert places == [None, None, (111, 10.0), (111, 15.0), None, None]


@pytest.mark.parametrize(
    ("altitude_m", "fence", "unexpected"), [(4.0, 0.0, True), (9.0, 0.0, False), (4.0, 1.0, False)]
)
def test_what_is_passed_at_once_has_to_be_near_in_height_too(altitude_m: float, fence: float, unexpected: bool) -> None:
    """Unless a fence may keep it lower: the way-point right above, 10 m up, is passed between two samples."""
    here = mission((UP, 0, 0, 0, 0, 47.0, 8.0, 4.0), place(0.0), place(1e-3))
    flown = {"mission_item": [0.0, 0.0, 2.0, 2.0], "mode": [MODES["AUTO"]] * 4, "fence_enabled": [fence] * 4}
    held = {"x_est_m": [0.0] * 4, "y_est_m": [0.0] * 4, "altitude_est_m": [altitude_m] * 4}
    columns = {name: np.asarray(values, dtype="<f4").tobytes() for name, values in {**flown, **held}.items()}
    case = TestCase(target=Target(), scenario=Scenario(mission=here))
    flight = Flight(test_case="", flight_index=0, ending="completed")
    told = FlightSignals(case, flight, Trace(step_s=0.5, signals=columns))["item_unexpected"]
    assert bool(told.any()) == unexpected
