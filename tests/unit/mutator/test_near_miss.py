"""The near-miss search keeps what came close and leaves what is broken."""

from __future__ import annotations

import msgspec
import pytest

from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Origin, Scenario, Target, TestCase, identity
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.mission import builtin_mission
from saflite.mutator.strategies.near_miss import Strategy

TEMPLATE = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2")))


def layout(x_m: float) -> tuple[Obstacle, ...]:
    return tuple(Obstacle(length_m=6.0, width_m=5.0, height_m=20.0, x_m=x, y_m=25.0) for x in (x_m, x_m + 10.0))


def outcome(x_m: float, margin: float, parent: str = "") -> Outcome:
    scenario = msgspec.structs.replace(TEMPLATE.scenario, obstacles=layout(x_m))
    case = msgspec.structs.replace(TEMPLATE, scenario=scenario, origin=Origin(parent=parent))
    violated = ("min-obstacle-distance",) if margin < 0 else ()
    return Outcome(test_case=case, round=0, ending="completed", robustness=margin, violated=violated)


def parents(strategy: Strategy, count: int = 60) -> set[str]:
    return {case.origin.parent for case in strategy.ask(count, derive(1, "ask"))}


def test_children_come_from_near_misses_and_stay_near() -> None:
    strategy = Strategy(TEMPLATE, {"population": 2, "fresh": 0.0}, (), describe())
    told = [outcome(-30.0, 0.2), outcome(0.0, 3.0)]
    strategy.tell(told)
    layouts = {identity(each.test_case): each.test_case.scenario.obstacles for each in told}
    children = strategy.ask(100, derive(1, "ask"))
    assert {case.origin.parent for case in children} == set(layouts)
    closest = sum(case.origin.parent == identity(told[0].test_case) for case in children)
    assert closest > 55, "the closer flight should be changed more often"
    for case in children:
        before, after = layouts[case.origin.parent], case.scenario.obstacles
        assert before != after
        assert all(abs(a.x_m - b.x_m) < 8 and abs(a.y_m - b.y_m) < 8 for a, b in zip(before, after, strict=True))


def test_a_broken_layout_and_its_parent_are_done_with() -> None:
    strategy = Strategy(TEMPLATE, {"population": 2, "fresh": 0.0}, (), describe())
    near, other = outcome(-30.0, 0.2), outcome(0.0, 3.0)
    strategy.tell([near, other])
    strategy.tell([outcome(-24.0, -0.1, parent=identity(near.test_case))])
    assert parents(strategy) == {identity(other.test_case)}
    strategy.tell([outcome(-28.5, 0.1)])
    assert parents(strategy) == {identity(other.test_case)}, "the same kind of layout is not taken up again"


def test_a_parent_whose_children_are_no_better_gives_way() -> None:
    strategy = Strategy(TEMPLATE, {"population": 1, "fresh": 0.0, "kept": 1}, (), describe())
    near, other = outcome(-30.0, 0.2), outcome(0.0, 0.5)
    strategy.tell([near, other])
    assert parents(strategy) == {identity(near.test_case)}
    strategy.tell([outcome(-29.0 - 0.01 * n, 0.6, parent=identity(near.test_case)) for n in range(4)])
    strategy.tell([other])
    assert parents(strategy) == {identity(other.test_case)}


def test_fresh_layouts_come_until_the_first_population_has_flown() -> None:
    strategy = Strategy(TEMPLATE, {"population": 2}, (), describe())
    strategy.tell([outcome(-30.0, 0.2)])
    assert parents(strategy) == {""}
    strategy.tell([outcome(0.0, 3.0)])
    assert len(parents(strategy)) == 3, "children of both and fresh ones"


def test_settings_of_the_fresh_layouts_are_taken() -> None:
    strategy = Strategy(TEMPLATE, {"gates": 0.0, "boxes_min": 4, "boxes_max": 4}, (), describe())
    assert {len(case.scenario.obstacles) for case in strategy.ask(10, derive(1, "ask"))} == {4}
    with pytest.raises(Refused, match="gates"):
        Strategy(TEMPLATE, {"gates": 2.0}, (), describe())


def test_how_many_rounds_are_told_at_once_makes_no_difference() -> None:
    rounds = [
        [outcome(0.0, 0.5), outcome(20.0, 1.0)],  # beyond `kept`: the second is dropped
        [outcome(0.0, -1.0), outcome(20.5, 2.0)],  # the first is done with; another of the kind that was dropped
    ]
    told = [[msgspec.structs.replace(one, round=number) for one in part] for number, part in enumerate(rounds)]
    by_round, at_once = (
        Strategy(TEMPLATE, {"kept": 1, "population": 1, "fresh": 0.0}, (), describe()) for _ in range(2)
    )
    for outcomes in told:
        by_round.tell(outcomes)
    at_once.tell([one for outcomes in told for one in outcomes])
    assert parents(by_round) - {""} == {identity(told[1][1].test_case)}
    assert parents(at_once) == parents(by_round)
