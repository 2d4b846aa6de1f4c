"""CAMBA against the published rules, worked out by hand from their description, and what is mended."""

from __future__ import annotations

import msgspec
import pytest

from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase, identity
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.geometry import COMPETITION_AREA, gap, inside, overlap
from saflite.flight.mission import builtin_mission
from saflite.mutator.operators import pairs, tracks
from saflite.mutator.operators.pairs import Anchor
from saflite.mutator.strategies.camba import Strategy, anchor_in

TEMPLATE = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2")))
NORTHWARDS = tuple((1.0, float(y)) for y in range(50))
Told = tuple[tuple[float, float, float, float], ...]


def a_box(x_m: float, length_m: float = 9.0, rotation_deg: float = 30.0, y_m: float = 25.0) -> Obstacle:
    return Obstacle(length_m=length_m, width_m=6.0, height_m=20.0, x_m=x_m, y_m=y_m, rotation_deg=rotation_deg)


def told(case: TestCase, track: tracks.Track = NORTHWARDS, distance_m: float = 2.0, **changes: object) -> Outcome:
    rows: Told = tuple((float(t), x, y, 10.0) for t, (x, y) in enumerate(track))
    violated = ("min-obstacle-distance",) if distance_m < 1.5 else ()
    fields = {"ending": "completed", "robustness": distance_m - 1.5, "violated": violated, **changes}
    return Outcome(test_case=case, round=0, track=rows, features={"min_distance_m": distance_m}, **fields)  # type: ignore[arg-type]


def published() -> Strategy:
    """Return the published tool after its flight of the bare mission."""
    strategy = Strategy(TEMPLATE, {"published": 1}, (), describe())
    bare = strategy.ask(1, derive(1, "bare"))
    assert bare[0].scenario.obstacles == ()
    strategy.tell([told(bare[0], distance_m=1000.0)])
    return strategy


# ---- the published rules ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("up", "length_m", "rotation_deg", "then"),
    [  # of the left box: (x, length, rotation) after a flight that passed left of it
        (True, 11.0, 30.0, (-11.0, 11.0, 20.0)),  # long and can turn: turned
        (True, 9.0, 8.0, (-11.0, 10.5, 8.0)),  # short and cannot turn: lengthened
        (True, 9.0, 30.0, (-11.0, 10.5, 20.0)),  # otherwise both
        (True, 11.0, 8.0, (-11.0, 12.5, -2.0)),
        (True, 10.5, 10.1, (-11.0, 10.5, 0.1)),  # at the limits
        (True, 10.5, 10.0, (-11.0, 12.0, 0.0)),
        (False, 11.0, 150.0, (-11.0, 11.0, 160.0)),  # flying down: mirrored, the limit is 170
        (False, 9.0, 175.0, (-11.0, 10.5, 175.0)),
        (False, 9.0, 150.0, (-11.0, 10.5, 160.0)),
        (False, 11.0, 170.0, (-11.0, 12.5, 180.0)),
    ],
)
def test_a_flight_past_the_left_box_moves_it_outwards(
    up: bool, length_m: float, rotation_deg: float, then: tuple[float, float, float]
) -> None:
    right = a_box(4.0, rotation_deg=120.0)
    left, other = pairs.moved((a_box(-10.0, length_m, rotation_deg), right), "left", up)
    assert (left.x_m, left.length_m, left.rotation_deg) == pytest.approx(then)
    assert other == right


@pytest.mark.parametrize(
    ("up", "length_m", "rotation_deg", "then"),
    [
        (True, 11.0, 150.0, (5.0, 11.0, 160.0)),
        (True, 9.0, 175.0, (5.0, 10.5, 175.0)),
        (False, 11.0, 30.0, (5.0, 11.0, 20.0)),
        (False, 9.0, 30.0, (5.0, 10.5, 20.0)),
    ],
)
def test_a_flight_past_the_right_box_does_the_mirrored_same(
    up: bool, length_m: float, rotation_deg: float, then: tuple[float, float, float]
) -> None:
    left = a_box(-10.0)
    other, right = pairs.moved((left, a_box(4.0, length_m, rotation_deg)), "right", up)
    assert (right.x_m, right.length_m, right.rotation_deg) == pytest.approx(then)
    assert other == left


def test_a_flight_between_the_boxes_moves_both_inwards() -> None:
    left, right = pairs.moved((a_box(-10.0), a_box(4.0)), "between", True)
    assert (left.x_m, right.x_m) == pytest.approx((-9.7, 3.7))
    assert (left.length_m, left.rotation_deg) == (9.0, 30.0)


@pytest.mark.parametrize(
    ("x_m", "reverse", "up", "passed"),
    [
        (-3.0, False, True, "between"),
        (-18.0, False, True, "left"),
        (14.0, False, True, "right"),
        (-18.0, True, False, "left"),
        (-18.0, True, True, "nowhere"),  # it flew there, but the other way
    ],
)
def test_where_a_flight_passed(x_m: float, reverse: bool, up: bool, passed: str) -> None:
    track = tuple((x_m, y) for _, y in NORTHWARDS)
    assert pairs.where(track[::-1] if reverse else track, (a_box(-10.0), a_box(4.0)), up) == passed


def test_a_flight_that_never_reached_the_boxes_passed_nowhere() -> None:
    assert pairs.where(NORTHWARDS[:10], (a_box(-10.0), a_box(4.0)), True) == "nowhere"


@pytest.mark.parametrize("up", [True, False])
def test_random_pairs_stand_as_the_published_ones(up: bool) -> None:
    anchor, near = Anchor(1.0, 25.0, up), tuple((1.0, 25.0 + n) for n in range(-5, 6))
    rng = derive(1, "pairs", int(up))
    for _ in range(12):
        pair = pairs.draw(rng, anchor, near, COMPETITION_AREA, None)
        assert pair is not None
        left, right = pair
        assert -14 <= left.x_m <= -4 <= 1 <= right.x_m <= 4
        assert (left.rotation_deg <= 90) == up == (right.rotation_deg >= 90)
        assert 5.6 <= gap(left, right) <= 7.8
        assert not overlap(left, right)
        for box in pair:
            assert 7 <= box.length_m <= 12
            assert 5 <= box.width_m <= 8
            assert 15 <= box.height_m <= 25
            assert abs(box.y_m - 25) <= 5
            assert inside(box, COMPETITION_AREA)
            assert not 2.8 < tracks.distance(box, near) < 3.9


def test_the_published_tool_follows_one_pair_and_leaves_it_where_it_is_hit_or_fails() -> None:
    strategy = published()
    first = strategy.ask(3, derive(1, "first"))
    assert {case.origin.parent for case in first} == {""}
    anchor = anchor_in(first[0].origin.note)
    assert anchor is not None
    assert 23 < anchor.y_m < 27
    assert anchor.up
    left, right = first[0].scenario.obstacles
    middle = tuple((0.5 * (left.x_m + right.x_m), y) for _, y in NORTHWARDS)
    strategy.tell([told(first[0], middle)])
    children = strategy.ask(5, derive(1, "second"))
    assert {identity(case) for case in children} == {identity(children[0])}, "its rules leave nothing to choose"
    assert [box.x_m for box in children[0].scenario.obstacles] == pytest.approx([left.x_m + 0.3, right.x_m - 0.3])
    strategy.tell([told(first[1], middle)])
    assert strategy.ask(1, derive(1, "third"))[0].origin.parent == identity(first[1]), "the last flight decides"
    strategy.tell([told(children[0], middle, distance_m=1.2)])
    assert strategy.ask(1, derive(1, "fourth"))[0].origin.parent == "", "a hit: a new point of the way"
    strategy.tell([told(first[1], middle)])
    strategy.tell([told(children[0], (), ending="wedged", robustness=None, violated=())])
    assert strategy.ask(1, derive(1, "fifth"))[0].origin.parent == "", "a failure: the pair is forgotten"


def test_a_flight_that_passed_nowhere_gives_a_new_pair_at_the_same_point() -> None:
    strategy = published()
    first = strategy.ask(1, derive(1, "first"))[0]
    strategy.tell([told(first, NORTHWARDS[:5])])
    child = strategy.ask(1, derive(1, "second"))[0]
    assert child.origin.parent == identity(first)
    assert anchor_in(child.origin.note) == anchor_in(first.origin.note)
    assert child.scenario.obstacles != first.scenario.obstacles


# ---- what is mended -----------------------------------------------------------------------------------------------


def test_the_first_pairs_need_no_flight_of_the_bare_mission_and_children_differ() -> None:
    strategy = Strategy(TEMPLATE, {"fresh": 0.0}, (), describe())
    first = strategy.ask(1, derive(1, "first"))[0]
    anchor = anchor_in(first.origin.note)
    assert anchor is not None
    left, right = first.scenario.obstacles
    middle = tuple((0.5 * (left.x_m + right.x_m), float(y)) for y in range(50))
    strategy.tell([told(first, middle if anchor.up else middle[::-1])])
    children = strategy.ask(5, derive(1, "second"))
    assert {case.origin.parent for case in children} == {identity(first)}
    assert len({identity(case) for case in children}) > 1
    for case in children:
        steps = case.scenario.obstacles[0].x_m - left.x_m
        assert 0.14 <= steps <= 0.46


def test_turned_boxes_are_known_again_by_their_side() -> None:
    up = msgspec.structs.replace(a_box(4.0, 11.0), rotation_deg=120.0)
    tidied = msgspec.structs.replace(up, length_m=6.0, width_m=11.0, rotation_deg=30.0)
    assert pairs.untidied((a_box(-10.0), tidied), True) == (a_box(-10.0), up)


def test_a_pair_that_comes_no_closer_is_given_up() -> None:
    strategy = Strategy(TEMPLATE, {"fresh": 0.0, "patience": 2}, (), describe())
    case = strategy.ask(1, derive(1, "first"))[0]
    strategy.tell([told(case, NORTHWARDS[:5], distance_m=4.0)])
    for number, followed in ((1, True), (2, False)):
        case = strategy.ask(1, derive(1, "next", number))[0]
        strategy.tell([told(case, NORTHWARDS[:5], distance_m=5.0)])
        assert (strategy.ask(1, derive(1, "last"))[0].origin.parent == identity(case)) == followed
