"""Test cases as numbers: what is equal stays equal, what matters moves the vector, history is kept slim."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from saflite.contract.errors import Unavailable
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.contract.work import Outcome
from saflite.flight.geometry import gap
from saflite.flight.mission import builtin_mission
from saflite.scorer_pool.geometry_score import look
from saflite.scorer_pool.learning.features import FEATURES, PATH_POINTS_MAX, features, path_points
from saflite.scorer_pool.learning.forest import FLIGHTS_MIN, danger, grow, step_size
from saflite.scorer_pool.learning.history import History
from saflite.scorer_pool.learning.vectors import Vectors
from saflite.scorer_pool.model import Job, Model, PolicyBrief, Tools
from saflite.scorer_pool.registry import make
from saflite.scorer_pool.relevance.knowledge import relation, table, words_of


def layout(*boxes: Obstacle, mission: str = "mission2") -> TestCase:
    return TestCase(target=Target(), scenario=Scenario(mission=builtin_mission(mission), obstacles=boxes))


def box(x: float, y: float, turn: float = 0.0) -> Obstacle:
    return Obstacle(length_m=8, width_m=4, height_m=20, x_m=x, y_m=y, rotation_deg=turn)


def stimulus(name: str, value: float) -> TestCase:
    given = Stimulus(at_s=1, kind="parameter", name=name, values=(value,))
    return TestCase(target=Target(), scenario=Scenario(start=StartState()), stimuli=(given,))


def test_order_of_boxes_does_not_matter_and_company_neither() -> None:
    a, b = box(-5, 15), box(5, 35, 30)
    alone = features([layout(a, b)])[0]
    company = features([layout(box(0, 20)), layout(b, a), stimulus("X", 1.0), layout(a, b, mission="mission3")])
    assert np.array_equal(alone, company[1])
    assert not np.array_equal(alone, company[3])


def test_first_numbers_are_count_gap_and_nearness() -> None:
    a, b = box(-20, 20), box(0, 20, 20)
    vector = features([layout(a, b)])[0]
    assert vector[0] == 2
    assert vector[1] == pytest.approx(gap(a, b), abs=1e-9)
    assert vector.shape == (FEATURES,)
    assert np.isfinite(vector).all()


def test_values_of_inputs_matter_and_odd_ones_do_no_harm() -> None:
    vectors = features([stimulus("P", 1.0), stimulus("P", 9.0), stimulus("P", math.inf), stimulus("P", 1e300)])
    assert np.isfinite(vectors).all()
    assert not np.array_equal(vectors[0], vectors[1])


def test_no_test_cases_no_rows() -> None:
    assert features([]).shape == (0, FEATURES)
    assert Vectors().of([]).shape == (0, FEATURES)


def test_vectors_are_the_features_in_the_order_asked() -> None:
    cases = [layout(box(float(place), 20)) for place in range(5)]
    kept = Vectors()
    kept.of(cases[:2])
    assert np.array_equal(kept.of([*cases, cases[0]]), features([*cases, cases[0]]))


def test_look_finds_a_narrow_passage_in_the_way_more_dangerous_than_a_wide_one_or_one_far_off() -> None:
    narrow = look(layout(box(-8, 25), box(3, 25)).scenario)
    wide = look(layout(box(-20, 25), box(12, 25)).scenario)
    far = look(layout(box(20, 12), box(29, 12)).scenario)
    assert narrow.gap_m == pytest.approx(3.0)
    assert narrow.score > wide.score
    assert narrow.score > far.score


HUGE = 3.4e38
ODD_BOXES: tuple[tuple[Obstacle, ...], ...] = (
    (box(2000.0, 2000.0),),
    (msgspec.structs.replace(box(0.0, 20.0), length_m=0.0), msgspec.structs.replace(box(1.0, 20.0), width_m=0.0)),
    (msgspec.structs.replace(box(0.0, 20.0), length_m=HUGE, width_m=HUGE), box(HUGE, -HUGE, HUGE)),
)


@pytest.mark.parametrize("boxes", ODD_BOXES)
@pytest.mark.parametrize("label", ["blend", "gap", "low_fidelity", "relevance", "novelty", "surrogate"])
def test_boxes_far_off_without_width_or_of_any_size_are_scored(label: str, boxes: tuple[Obstacle, ...]) -> None:
    def part(other: str) -> Model:
        return make(other, Tools(_Clock(), part))

    case = layout(*boxes)
    history = tuple(outcome(one, 0, 1.0) for one in [case, layout(*ODD_BOXES[2])] * FLIGHTS_MIN)
    job = Job((case,), (), 1, 1, history, 0, 60.0, None, lambda: False)
    (score,) = part(label).score(job).scores
    assert 0.0 <= score.value <= 10.0


class _Clock:
    def monotonic_s(self) -> float:
        return 0.0

    def unix_s(self) -> float:
        return 0.0


def test_a_mission_to_the_end_of_the_world_is_looked_at_in_few_points() -> None:
    mission = builtin_mission("mission2")
    far = tuple(msgspec.structs.replace(item, params=(*item.params[:6], HUGE)) for item in mission.items)
    assert len(path_points(msgspec.structs.replace(mission, items=far))) < 2 * PATH_POINTS_MAX


def outcome(case: TestCase, round_: int, margin: float | None) -> Outcome:
    return Outcome(
        test_case=case, round=round_, ending="completed", robustness=margin, track=((0.0, 0.0, 0.0, 0.0),) * 50
    )


def test_history_is_kept_slim_in_order_and_notices_gaps() -> None:
    history = History()
    cases = [layout(box(float(place), 20)) for place in range(6)]
    copies = [msgspec.msgpack.decode(msgspec.msgpack.encode(case), type=TestCase) for case in cases]
    history.tell(tuple(outcome(case, place // 2, 1.0) for place, case in enumerate(copies)), -1, 2)
    seen = history.view(-1, 1)
    assert [one.test_case for one in seen] == cases[:4]
    assert all(one.track == () for one in seen)
    assert len({id(one.test_case.scenario.mission) for one in history.view(-1, 2)}) == 1
    with pytest.raises(Unavailable):
        history.tell((), 7, 8)


def test_forest_is_the_same_for_the_same_flights_and_tells_near_from_far() -> None:
    cases = [layout(box(float(place), 25)) for place in range(-20, 20)]
    told = [outcome(case, 0, abs(case.scenario.obstacles[0].x_m) - 5.0) for case in cases]
    told = [msgspec.structs.replace(one, violated=("p",) if (one.robustness or 0) < 0 else ()) for one in told]
    first, second = (grow(told, Vectors()) for _ in range(2))
    asked = features([layout(box(0.5, 25)), layout(box(18.5, 25))])
    assert np.array_equal(first.predict(asked), second.predict(asked))
    near, far = first.predict(asked)
    assert near > far
    assert first.skill is not None
    assert first.skill > 0.8


def test_danger_is_half_at_the_border_whatever_the_unit() -> None:
    for unit in (1.0, 1000.0):
        low, border, high = danger([-unit, 0.0, unit])
        assert low > border > high
        assert border == 0.5


def switched(value: float, on: bool, place: int) -> TestCase:
    """A case whose rule applies only where the switch is given; the value decides how near it comes."""
    given = [Stimulus(at_s=2, kind="parameter", name="MARGIN", values=(value,))]
    given += [Stimulus(at_s=1, kind="mode", name="FLIP", values=(float(place),))] if on else []
    return TestCase(target=Target(), scenario=Scenario(start=StartState()), stimuli=tuple(given))


def flights_with_a_switch(silent: int) -> list[Outcome]:
    """Twenty flights in which the rule applied, margins from -1 to 18, and `silent` in which it never did."""
    applied = [
        Outcome(
            test_case=switched(float(place), True, place),
            round=0,
            ending="completed",
            robustness=place - 1.0,
            violated=("p",) if place < 1 else (),
        )
        for place in range(20)
    ]
    never = [
        Outcome(
            test_case=switched(float(place % 20), False, 0), round=1, ending="completed", robustness=None, nearness=0.5
        )
        for place in range(silent)
    ]
    return applied + never


def test_flights_in_which_no_rule_applied_are_no_evidence_of_safety() -> None:
    """However many there are, near and far among the applied stay as far apart as they were without them."""
    near, far, silent = (
        features([switched(0.5, True, 3), switched(18.0, True, 3), switched(0.5, False, 0)])[n] for n in range(3)
    )
    for many in (20, 200):
        forest = grow(flights_with_a_switch(many), Vectors())
        alone = grow(flights_with_a_switch(0), Vectors())
        told = forest.predict(np.stack([near, far, silent]))
        assert told[0] > 0.8 * alone.predict(near[None])[0] > 0.25
        assert told[0] - told[1] > 0.1, "near and far are told apart"
        assert told[2] < told[0], "what never applied cannot break a rule"
        assert forest.skill is not None
        assert forest.skill > 0.9


def test_before_enough_has_applied_what_comes_nearer_to_applying_is_preferred() -> None:
    told = [
        Outcome(
            test_case=stimulus("HELPS" if place % 2 else "OTHER", 1.0 + place),
            round=0,
            ending="completed",
            robustness=None,
            nearness=0.9 if place % 2 else 0.1,
        )
        for place in range(24)
    ]
    forest = grow(told, Vectors())
    assert forest.dangers is None
    helps, other = forest.predict(features([stimulus("HELPS", 7.0), stimulus("OTHER", 7.0)]))
    assert 0.3 > helps > other + 0.1
    assert forest.skill is None


def test_forests_grow_in_steps() -> None:
    sizes = [step_size(count) for count in range(FLIGHTS_MIN, 400)]
    assert all(size <= count for count, size in enumerate(sizes, FLIGHTS_MIN))
    assert sorted(sizes) == sizes
    assert len(set(sizes)) < 60


CHUTE = PolicyBrief("a-chute", "A parachute may open only if armed and not in ACRO.", ("chute_released", "mode"))
HOLD = PolicyBrief("hold", "In ALT_HOLD with the throttle in the middle keep the altitude.", ("altitude_m",))


@pytest.mark.parametrize(
    ("brief", "relevant", "other"),
    [
        (CHUTE, ("command", "MAV_CMD_DO_PARACHUTE"), ("parameter", "ATC_RAT_RLL_FF")),
        (CHUTE, ("mode", "ACRO"), ("sensor_fault", "SIM_FLOW_RATE")),
        (HOLD, ("stick", "RC3"), ("command", "MAV_CMD_DO_SEND_BANNER")),
        (HOLD, ("parameter", "EK2_ALT_SOURCE"), ("parameter", "RTL_LOITER_RAD")),
    ],
)
def test_relation_knows_what_bears_on_a_policy(
    brief: PolicyBrief, relevant: tuple[str, str], other: tuple[str, str]
) -> None:
    assert relation(*relevant, brief) > relation(*other, brief)


def test_names_become_words_and_the_table_is_whole() -> None:
    assert {"return", "altitude"} <= words_of("RTL_ALT")
    assert len(table()) > 250
    assert "altitude" in table()["RC3"].moves
