"""TUMB against the published rules, worked out by hand from their description, and what is corrected."""

from __future__ import annotations

import math

import msgspec
import pytest

from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Origin, Scenario, Target, TestCase, identity
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.geometry import COMPETITION_AREA, corner_points
from saflite.flight.mission import builtin_mission
from saflite.mutator.operators import circles
from saflite.mutator.strategies.tumb import ROOT, Strategy, places

TEMPLATE = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2")))
NORTHWARDS = tuple((1.0, float(y)) for y in range(50))


def a_box(x_m: float, y_m: float = 25.0) -> Obstacle:
    return Obstacle(length_m=8.0, width_m=4.0, height_m=25.0, x_m=x_m, y_m=y_m)


def case(layout: tuple[Obstacle, ...], parent: str = ROOT) -> TestCase:
    scenario = msgspec.structs.replace(TEMPLATE.scenario, obstacles=layout)
    return msgspec.structs.replace(TEMPLATE, scenario=scenario, origin=Origin(parent=parent))


def told(flown: TestCase, distance_m: float, **changes: object) -> Outcome:
    rows = tuple((float(t), x, y, 10.0) for t, (x, y) in enumerate(NORTHWARDS))
    violated = ("min-obstacle-distance",) if distance_m < 1.5 else ()
    fields = {"ending": "completed", "robustness": distance_m - 1.5, "violated": violated, **changes}
    return Outcome(test_case=flown, round=0, track=rows, features={"min_distance_m": distance_m}, **fields)  # type: ignore[arg-type]


def published() -> Strategy:
    """Return the published tool after its flight of the bare mission."""
    strategy = Strategy(TEMPLATE, {"published": 1}, (), describe())
    bare = strategy.ask(1, derive(1, "bare"))
    assert bare[0].scenario.obstacles == ()
    strategy.tell([told(bare[0], 1000.0)])
    return strategy


def corrected() -> Strategy:
    return Strategy(TEMPLATE, {}, (), describe())


# ---- the published rules ------------------------------------------------------------------------------------------


def test_a_box_is_covered_by_sixteen_circles() -> None:
    cover = circles.cover(a_box(0.0, 0.0))
    assert {(round(x, 9), round(y, 9)) for x, y, _ in cover} == {
        (x, y) for x in (-3.0, -1.0, 1.0, 3.0) for y in (-1.5, -0.5, 0.5, 1.5)
    }
    assert {round(radius, 6) for _, _, radius in cover} == {round(math.sqrt(1.25), 6)}


def test_the_free_circle_meets_neither_border_nor_box() -> None:
    assert circles.free_radius((1.0, 14.0), (), COMPETITION_AREA) == 4.0
    nearest = math.hypot(7.0, 0.5) - math.sqrt(1.25)  # to the circles about (3, 24.5) and (3, 25.5)
    assert circles.free_radius((10.0, 25.0), (a_box(0.0),), COMPETITION_AREA) == pytest.approx(nearest)
    assert circles.free_radius((1.0, 25.5), (a_box(0.0),), COMPETITION_AREA) == pytest.approx(-math.sqrt(1.25))


def test_boxes_are_drawn_inside_the_circle() -> None:
    rng = derive(1, "boxes")
    sides = []
    for _ in range(200):
        box = circles.draw_inside(rng, (3.0, 20.0), 5.0)
        sides.append(box.length_m)
        assert box.height_m == 25.0
        assert 0 <= box.rotation_deg <= 90
        for x, y in corner_points(box):
            assert math.hypot(x - 3.0, y - 20.0) == pytest.approx(0.999 * 5.0)
    assert 0.999 <= min(sides) < 1.5
    assert 8.5 < max(sides) <= 0.999 * 9.0
    later = [circles.draw_radius(rng, (10.0, 25.0), (a_box(0.0),), COMPETITION_AREA) for _ in range(200)]
    free = circles.free_radius((10.0, 25.0), (a_box(0.0),), COMPETITION_AREA)
    assert 0.5 * free <= min(later) < 0.55 * free
    assert 0.85 * free < max(later) <= 0.9 * free


def test_the_first_box_stands_early_on_the_way_later_ones_anywhere_in_the_area() -> None:
    rules = published()._rules
    assert [y for _, y in places(NORTHWARDS, rules, is_later=False)] == [11.0, 12.0, 13.0, 14.0, 15.0]
    assert [y for _, y in places(NORTHWARDS, rules, is_later=True)] == [float(y) for y in range(11, 40)]


@pytest.mark.parametrize("strategy", [published(), corrected()], ids=["published", "corrected"])
def test_a_node_is_expanded_while_its_children_are_few_for_its_visits(strategy: Strategy) -> None:
    assert strategy.select() == ROOT
    layout: tuple[Obstacle, ...] = ()
    names = [ROOT]
    for number in range(4):  # 1 > 0.4 sqrt(1..4), 1 > 0.5 sqrt(1..3), ...: the search goes down
        layout = (*layout, a_box(-30.0 + 12 * number))
        child = case(layout, names[-1])
        strategy.tell([told(child, 3.0)])
        names.append(identity(child))
        if number < 3:
            assert strategy.select() == names[-1]
    assert strategy.select() == names[1], "four visits of the node of one box: 1 <= 0.5 sqrt(4)"
    for number in range(2):
        strategy.tell([told(case((*layout[:1], a_box(20.0, 20.0 + number)), names[1]), 3.0)])
    assert strategy.select() != ROOT, "1 > 0.4 sqrt(6)"
    strategy.tell([told(case((*layout[:1], a_box(20.0, 30.0)), names[1]), 3.0)])
    assert strategy.select() == ROOT, "1 <= 0.4 sqrt(7)"


def test_the_published_tool_goes_by_the_mean_the_mended_one_by_the_best() -> None:
    a, b = case((a_box(-10.0),)), case((a_box(10.0),))
    below = [case((a_box(-10.0), a_box(x)), identity(a)) for x in (5.0, 18.0)]
    flights = [told(a, 3.0), told(b, 2.5), told(below[0], 1.8), told(below[1], 9.0)]
    for strategy, expected in ((published(), identity(b)), (corrected(), identity(below[0]))):
        strategy.tell(flights)
        # mean of a: -13.8 / 3 = -4.6, bonus 0.68; of b: -2.5, bonus 1.18; best of a: -1.8, bonus 0.68
        assert strategy.select() == expected


def test_the_published_tool_forgets_a_flight_that_failed_and_a_perfect_collision_but_counts_the_visit() -> None:
    strategy = published()
    collided, failed = case((a_box(-10.0),)), case((a_box(0.0),))
    strategy.tell([told(collided, 0.0), told(failed, 0.0, ending="wedged", robustness=None, violated=())])
    assert strategy.select() == ROOT
    assert strategy._nodes[ROOT].visits == 2
    assert list(strategy._nodes) == [ROOT]


# ---- what is corrected -----------------------------------------------------------------------------------------------


def test_what_is_broken_is_not_built_upon_and_a_failure_counts_for_nothing() -> None:
    strategy = corrected()
    broken, failed = case((a_box(-10.0),)), case((a_box(0.0),))
    strategy.tell([told(broken, 0.0), told(failed, 0.0, ending="wedged", robustness=None, violated=())])
    assert {one.origin.parent for one in strategy.ask(10, derive(1, "ask"))} == {ROOT}
    assert strategy._nodes[ROOT].visits == 1


def test_siblings_share_a_node_and_each_group_counts_as_a_visit() -> None:
    strategy = corrected()
    children = [case((a_box(x),)) for x in (-20.0, 0.0, 15.0)]
    strategy.tell([told(child, 3.0) for child in children])
    asked = strategy.ask(15, derive(1, "ask"))
    groups = [{one.origin.parent for one in asked[start : start + 5]} for start in (0, 5, 10)]
    assert all(len(group) == 1 for group in groups)
    assert set.union(*groups) == {identity(child) for child in children}


def test_an_area_without_room_on_the_way_gives_layouts_elsewhere() -> None:
    strategy = Strategy(TEMPLATE, {"clearance_m": 0.0, "x_min_m": -39.0, "x_max_m": -20.0}, (), describe())
    for one in strategy.ask(5, derive(1, "ask")):
        assert len(one.scenario.obstacles) == 1
