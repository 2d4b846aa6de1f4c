"""Operators on boxes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from shapely.geometry import Polygon

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.geometry import COMPETITION_AREA, COMPETITION_SIZES, Area, corners, gap, point_distance
from saflite.flight.mission import Waypoint, builtin_mission, waypoints
from saflite.mutator.operators import boxes, layouts
from saflite.mutator.strategies.random_boxes import Strategy

TEMPLATE = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2")))


@given(st.floats(2, 20), st.floats(2, 20), st.floats(-720, 720))
def test_tidying_keeps_the_box_where_it_is(length_m: float, width_m: float, rotation_deg: float) -> None:
    box = Obstacle(length_m=length_m, width_m=width_m, height_m=20.0, x_m=1.0, y_m=20.0, rotation_deg=rotation_deg)
    after = boxes.tidy(box)
    assert 0 <= after.rotation_deg <= 90
    assert Polygon(corners(box)).hausdorff_distance(Polygon(corners(after))) < 0.03  # 0.05 degrees at 14 m


def test_clipping_legs_to_the_area() -> None:
    area = Area(-40, 30, 10, 40)
    places = [
        Waypoint("takeoff", 0, 0, 10),
        Waypoint("waypoint", 0, 50, 10),
        Waypoint("waypoint", 60, 50, 10),
        Waypoint("land", -30, 20, 0),
    ]
    first, last = boxes.legs_in_area(places, area)
    assert first == pytest.approx((0, 10, 0, 40))
    assert last == pytest.approx((30, 40, -30, 20))


def test_way_points_are_kept_clear() -> None:
    rules = boxes.Rules(COMPETITION_AREA, COMPETITION_SIZES, keep_clear=((0.0, 25.0),), clearance_m=3.0)
    box = Obstacle(length_m=10.0, width_m=5.0, height_m=20.0, x_m=7.9, y_m=25.0)
    assert not boxes.allowed(box, (), rules)
    assert boxes.allowed(boxes.nudge(box, "x_m", 0.2), (), rules)


def test_gates_stand_astride_the_path_and_random_boxes_spread_over_the_area() -> None:
    gates = Strategy(TEMPLATE, {"gates": 1}, (), describe()).ask(60, derive(1, "gates"))
    assert {case.origin.note for case in gates} == {"gate"}
    legs = boxes.legs_in_area(
        [Waypoint("takeoff", 0, 0, 10), Waypoint("waypoint", -6.8, 54, 10), Waypoint("land", -12.3, 0.1, 0)],
        COMPETITION_AREA,
    )
    for case in gates:
        first, second = case.scenario.obstacles
        on_legs = [(x0 + k * (x1 - x0) / 50, y0 + k * (y1 - y0) / 50) for x0, y0, x1, y1 in legs for k in range(51)]
        assert min(point_distance(first, x, y) for x, y in on_legs) <= 5.0
        assert gap(first, second) < 16.0
    spread = Strategy(TEMPLATE, {"gates": 0, "boxes_min": 4, "boxes_max": 4}, (), describe()).ask(
        60, derive(1, "spread")
    )
    middles = [box.x_m for case in spread for box in case.scenario.obstacles]
    assert len(middles) == 240
    assert min(middles) < -30
    assert max(middles) > 20


@pytest.mark.parametrize("count", [2, 3])
def test_walls_stand_across_the_path_with_a_passage_beside_them(count: int) -> None:
    strategy = Strategy(TEMPLATE, {"walls": 1, "gates": 0, "boxes_min": count, "boxes_max": count}, (), describe())
    walls = strategy.ask(60, derive(1, "walls"))
    assert {case.origin.note for case in walls} == {"wall"}
    assert TEMPLATE.scenario.mission is not None
    way = waypoints(TEMPLATE.scenario.mission)
    legs = boxes.legs_in_area(way, COMPETITION_AREA)
    for case in walls:
        layout = case.scenario.obstacles
        first, second = layout[:2]
        on_legs = [(x0 + k * (x1 - x0) / 50, y0 + k * (y1 - y0) / 50) for x0, y0, x1, y1 in legs for k in range(51)]
        assert min(point_distance(first, x, y) for x, y in on_legs) <= 1.0, "6 m wide, at most 3 m off the path"
        assert 5.0 <= gap(first, second) <= 8.0
        assert all(min(gap(box, other) for other in layout if other is not box) <= 8.0 for box in layout[2:])
        rules = boxes.Rules(COMPETITION_AREA, COMPETITION_SIZES, boxes.places_to_keep_clear(TEMPLATE.scenario.mission))
        assert all(boxes.allowed(box, layout[:place], rules) for place, box in enumerate(layout))
    assert sum(len(case.scenario.obstacles) == count for case in walls) >= 55, "further boxes mostly find room"


def test_without_walls_draws_are_as_before() -> None:
    shipped, none = Strategy(TEMPLATE, {}, (), describe()), Strategy(TEMPLATE, {"walls": 0}, (), describe())
    assert shipped.ask(10, derive(1, "draws")) == none.ask(10, derive(1, "draws"))
    assert {case.origin.note for case in shipped.ask(40, derive(1, "draws"))} == {"gate", "anywhere"}


def test_rules_without_room_are_refused() -> None:
    tight = {"x_min_m": 0.0, "x_max_m": 5.0, "y_min_m": 10.0, "y_max_m": 15.0, "side_min_m": 4.0, "gates": 0}
    with pytest.raises(Refused, match="room"):
        Strategy(TEMPLATE, {**tight, "boxes_min": 4, "boxes_max": 4}, (), describe()).ask(1, derive(1, "tight"))


@pytest.mark.parametrize("pair", [{"x_min_m": 50.0}, {"side_min_m": 30.0}, {"height_max_m": 12.0}, {"boxes_min": 4}])
def test_limits_the_wrong_way_round_are_refused(pair: dict[str, float]) -> None:
    with pytest.raises(Refused, match="at most"):
        Strategy(TEMPLATE, dict(pair), (), describe())


def test_drawing_counts_stay_in_their_limits() -> None:
    drawn = {layouts.count_between(derive(1, n), 2, 4) for n in range(60)}
    assert drawn == {2, 3, 4}
