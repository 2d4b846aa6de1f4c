"""DeepHyperion's archive, ranking and mutation, with its published faults mended."""

from __future__ import annotations

import msgspec
import pytest

from saflite.contract.rng import derive
from saflite.contract.test_case import Obstacle, Origin, Scenario, Target, TestCase, identity
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.geometry import COMPETITION_AREA, COMPETITION_SIZES
from saflite.flight.mission import builtin_mission
from saflite.mutator.operators.boxes import Rules, allowed, tidy
from saflite.mutator.strategies import deephyperion
from saflite.mutator.strategies.deephyperion import Strategy, mutate, rank_index

TEMPLATE = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission2")))
RULES = Rules(COMPETITION_AREA, COMPETITION_SIZES)


def a_box(x_m: float, y_m: float = 25.0, **changes: float) -> Obstacle:
    return Obstacle(**{"length_m": 8.0, "width_m": 5.0, "height_m": 20.0, "x_m": x_m, "y_m": y_m, **changes})


def outcome(layout: tuple[Obstacle, ...], distance_m: float, parent: str = "") -> Outcome:
    scenario = msgspec.structs.replace(TEMPLATE.scenario, obstacles=layout)
    case = msgspec.structs.replace(TEMPLATE, scenario=scenario, origin=Origin(parent=parent))
    features = {"min_distance_m": distance_m}
    return Outcome(test_case=case, round=0, ending="completed", robustness=distance_m - 1.5, features=features)


def test_a_child_differs_from_its_parent_in_one_attribute_of_one_box() -> None:
    parent = (tidy(a_box(-10, rotation_deg=40)), tidy(a_box(10, rotation_deg=45)))
    rng = derive(1, "children")
    for _ in range(300):
        child = mutate(rng, parent, RULES)
        assert child is not None
        changed = [(old, new) for old, new in zip(parent, child[0], strict=True) if old != new]
        assert len(changed) == 1
        old, new = (msgspec.structs.asdict(box) for box in changed[0])
        different = [word for word in old if old[word] != new[word]]
        assert len(different) == 1, different
        step = abs(old[different[0]] - new[different[0]])
        assert 10 - 0.06 <= step <= 20.06 if different == ["rotation_deg"] else 2 - 0.006 <= step <= 5.006
        assert allowed(child[0][0], [child[0][1]], RULES)


def test_children_never_leave_the_area_or_the_size_limits() -> None:
    layout: tuple[Obstacle, ...] = (tidy(a_box(-35, 15, rotation_deg=10)), tidy(a_box(19.0, 35, length_m=19.5)))
    rng = derive(2, "walk")
    seen = set()
    for _ in range(400):
        child = mutate(rng, layout, RULES)
        assert child is not None
        layout, note = child
        seen.add(note.split()[2])
        assert allowed(layout[0], [layout[1]], RULES)
        assert allowed(layout[1], [layout[0]], RULES)
        assert all(0 <= box.rotation_deg <= 90 for box in layout)
    assert seen == {"rotation_deg", "x_m", "y_m", "length_m", "width_m"}


def test_mutation_gives_up_where_nothing_is_allowed() -> None:
    nowhere = RULES._replace(keep_clear=((0.0, 25.0),), clearance_m=1000.0)
    assert mutate(derive(3, "none"), (a_box(0), a_box(20)), nowhere) is None


def test_cells_are_real_cells() -> None:
    strategy = Strategy(TEMPLATE, {"population": 1, "cells": 10}, (), describe())
    near = strategy.cell((a_box(0), a_box(10)))
    assert near == strategy.cell((a_box(0), a_box(10.4))), "a few decimetres are the same kind of layout"
    assert near == strategy.cell((a_box(10), a_box(0))), "the order of the boxes does not matter"
    assert near != strategy.cell((a_box(0), a_box(20)))
    assert near != strategy.cell((a_box(0, 15), a_box(0, 35)))


def test_the_archive_keeps_the_closest_flight_of_a_cell_and_credits_parents() -> None:
    strategy = Strategy(TEMPLATE, {"population": 1, "cells": 10, "rank_share": 1}, (), describe())
    first = outcome((a_box(0), a_box(10)), 3.0)
    parent = identity(first.test_case)
    better = outcome((a_box(0), a_box(10.2)), 2.0, parent)
    worse = outcome((a_box(0), a_box(10.3)), 2.5, parent)
    elsewhere = outcome((a_box(0, 15), a_box(0, 35)), 9.0)
    strategy.tell([first])
    assert {case.origin.parent for case in strategy.ask(5, derive(1, "a"))} == {parent}
    strategy.tell([better, worse, elsewhere])
    parents = {case.origin.parent for case in strategy.ask(60, derive(1, "a"))}
    assert parents == {identity(better.test_case), identity(elsewhere.test_case)}


def test_nothing_is_mutated_before_the_first_population_has_flown() -> None:
    strategy = Strategy(TEMPLATE, {"population": 3}, (), describe())
    strategy.tell([outcome((a_box(0), a_box(10)), 3.0), outcome((a_box(0), a_box(20)), 3.0)])
    assert {case.origin.parent for case in strategy.ask(10, derive(1, "a"))} == {""}
    strategy.tell([outcome((a_box(0), a_box(-20)), 3.0)])
    assert "" not in {case.origin.parent for case in strategy.ask(10, derive(1, "a"))}


def test_ranking_favours_the_first_in_the_published_proportion() -> None:
    draws = derive(5, "rank").random(20_000)
    first = sum(rank_index(draw, 10, 1.5) == 0 for draw in draws) / len(draws)
    last = sum(rank_index(draw, 10, 1.5) == 9 for draw in draws) / len(draws)
    # linear ranking: the density falls from bias at the first to 2 - bias at the last
    assert first == pytest.approx(0.1475, abs=0.01)
    assert last == pytest.approx(0.0525, abs=0.01)
    assert rank_index(1.0, 10, 1.5) == 9


def test_first_layouts_stand_where_the_published_tool_puts_them() -> None:
    strategy = Strategy(TEMPLATE, {"gates": 0}, (), describe())
    for case in strategy.ask(50, derive(1, "first")):
        for box in case.scenario.obstacles:
            assert deephyperion.FIRST_PLACE.x_min_m <= box.x_m <= deephyperion.FIRST_PLACE.x_max_m
            assert deephyperion.FIRST_PLACE.y_min_m <= box.y_m <= deephyperion.FIRST_PLACE.y_max_m
