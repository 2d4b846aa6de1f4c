"""Every strategy, found by its place, keeps the same promises."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np
import pytest

from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.test_case import Origin, Scenario, StartState, Target, TestCase, identity
from saflite.contract.work import MutateResult, MutateWork, Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.geometry import COMPETITION_AREA, COMPETITION_SIZES, check_layout
from saflite.flight.mission import builtin_mission, mission_names
from saflite.mutator import registry
from saflite.mutator.strategy import Strategy
from saflite.mutator.work import open_service

NAMES = registry.strategy_names()
POLICIES = {"obstacles": ("min-obstacle-distance",), "stimuli": ("a-chute",)}


def template(name: str, mission: str = "mission2") -> TestCase:
    if registry.load_strategy(name).proposes == "obstacles":
        scenario = Scenario(mission=builtin_mission(mission))
    else:
        scenario = Scenario(start=StartState(), time_limit_s=60.0)
    return TestCase(target=Target(), scenario=scenario, rng_seed=5)


def make(name: str, mission: str = "mission2") -> Strategy:
    kind = registry.load_strategy(name)
    return kind(template(name, mission), {}, POLICIES[kind.proposes], describe())


def outcome_of(case: TestCase, round_: int) -> Outcome:
    """An outcome that depends on the test case alone, as a deterministic target's would."""
    draw = derive(0, "outcome", identity(case)).uniform(-1.0, 6.0)
    violated = ("some-policy",) if draw < 0 else ()
    features = {"min_distance_m": float(draw) + 1.5}
    return Outcome(
        test_case=case, round=round_, ending="completed", robustness=float(draw), violated=violated, features=features
    )


def rounds_of(strategy: Strategy, count: int, tell_from: int = 0) -> list[list[Outcome]]:
    """Fly some rounds: ask, let every second test case fly, tell."""
    told = []
    for round_ in range(tell_from, tell_from + count):
        cases = strategy.ask(20, derive(3, "mutate", round_))
        cases = [msgspec.structs.replace(case, origin=numbered(case.origin, round_)) for case in cases]
        outcomes = [outcome_of(case, round_) for case in cases[::2]]
        strategy.tell(outcomes)
        told.append(outcomes)
    return told


def numbered(origin: Origin, round_: int) -> Origin:
    return msgspec.structs.replace(origin, round=round_)


def asked(strategy: Strategy, label: int = 99) -> list[TestCase]:
    return strategy.ask(15, derive(1, label))


@pytest.mark.parametrize("name", NAMES)
def test_it_is_described_and_its_settings_are_documented(name: str) -> None:
    kind = registry.load_strategy(name)
    assert len(registry.describe(name)) > 80
    assert kind.proposes in POLICIES
    for setting, option in kind.options.items():
        assert len(option.meaning) > 8, f"{setting} is not explained"
        if isinstance(option.default, int | float) and not isinstance(option.default, bool):
            assert option.least <= option.default <= option.most


@pytest.mark.parametrize("name", NAMES)
def test_it_refuses_settings_it_does_not_know_or_that_are_out_of_range(name: str) -> None:
    kind = registry.load_strategy(name)
    policies = POLICIES[kind.proposes]
    with pytest.raises(Refused, match="'speeed'"):
        kind(template(name), {"speeed": 3}, policies, describe())
    for setting, option in kind.options.items():
        with pytest.raises(Refused, match=setting):
            kind(template(name), {setting: ["a", "list"]}, policies, describe())
        if isinstance(option.default, int | float) and option.most < float("inf"):
            with pytest.raises(Refused, match=setting):
                kind(template(name), {setting: type(option.default)(option.most + 1)}, policies, describe())


@pytest.mark.parametrize("name", NAMES)
def test_it_refuses_a_template_it_cannot_mutate(name: str) -> None:
    bare = TestCase(target=Target(), scenario=Scenario())
    kind = registry.load_strategy(name)
    with pytest.raises(Refused):
        kind(bare, {}, POLICIES[kind.proposes], describe())


@pytest.mark.parametrize("name", NAMES)
def test_it_gives_as_many_as_asked_and_the_same_for_the_same_draw(name: str) -> None:
    for count in (1, 7, 40):
        first, second = make(name), make(name)
        cases = first.ask(count, derive(4, "ask"))
        assert len(cases) == count
        assert cases == second.ask(count, derive(4, "ask"))
    assert asked(make(name), 1) != asked(make(name), 2)
    assert len({identity(case) for case in make(name).ask(40, derive(4, "ask"))}) > 30


@pytest.mark.parametrize("name", NAMES)
def test_its_state_depends_on_tells_only(name: str) -> None:
    strategy = make(name)
    told = rounds_of(strategy, 6)
    expected = asked(strategy)
    for label in range(5):
        asked(strategy, label)
    assert asked(strategy) == expected, "asking changed the state"

    again = make(name)
    for outcomes in told:
        again.tell(outcomes)
    assert asked(again) == expected, "telling everything again round by round gave another strategy"

    at_once = make(name)
    at_once.tell([outcome for outcomes in told for outcome in outcomes])
    assert asked(at_once) == expected, "telling everything at once gave another strategy"


@pytest.mark.parametrize("name", NAMES)
def test_it_survives_flights_that_say_nothing_and_test_cases_of_others(name: str) -> None:
    strategy = make(name)
    stranger = template(name)
    silent = [
        Outcome(test_case=stranger, round=0, ending=ending, robustness=None) for ending in ("wedged", "lost", "infra")
    ]
    strategy.tell(silent)
    strategy.tell([outcome_of(stranger, 0)])
    assert len(asked(strategy)) == 15


@pytest.mark.parametrize("name", NAMES)
def test_what_it_proposes_keeps_the_template_and_names_its_origin(name: str) -> None:
    strategy = make(name)
    told = rounds_of(strategy, 5)
    known = {identity(outcome.test_case) for outcomes in told for outcome in outcomes}
    base = template(name)
    for case in asked(strategy):
        assert case.target.name == base.target.name
        assert case.scenario.mission == base.scenario.mission
        assert case.rng_seed == base.rng_seed
        assert case.origin.strategy == name
        assert case.origin.parent == "" or case.origin.parent in known
        assert wire.decode(wire.encode(case), TestCase) == case


def obstacle_strategies() -> Sequence[str]:
    return [name for name in NAMES if registry.load_strategy(name).proposes == "obstacles"]


@pytest.mark.parametrize("mission", mission_names())
@pytest.mark.parametrize("name", obstacle_strategies())
def test_layouts_keep_the_rules_of_the_competition(name: str, mission: str) -> None:
    strategy = make(name, mission)
    told = rounds_of(strategy, 5)
    cases = [outcome.test_case for outcomes in told for outcome in outcomes] + asked(strategy)
    for case in cases:
        assert case.scenario.obstacles
        check_layout(case.scenario.obstacles, COMPETITION_AREA, 4, COMPETITION_SIZES)
        assert all(0 <= box.rotation_deg <= 90 for box in case.scenario.obstacles)


@pytest.mark.parametrize("name", NAMES)
def test_the_service_restarts_from_zero_and_says_the_same(name: str) -> None:
    strategy = make(name)
    told = rounds_of(strategy, 4)
    kind = registry.load_strategy(name)
    base, policies = template(name), POLICIES[kind.proposes]

    def work(outcomes: list[Outcome], from_cursor: int, cursor: int) -> MutateWork:
        return MutateWork(
            round=7,
            count=12,
            strategy=name,
            settings={},
            rng_seed=2,
            template=base,
            target=describe(),
            policies=policies,
            outcomes=tuple(outcomes),
            from_cursor=from_cursor,
            cursor=cursor,
        )

    def run(service: object, order: MutateWork) -> MutateResult:
        result = service.do(order, lambda: False)  # type: ignore[attr-defined]
        assert isinstance(result, MutateResult)
        return result

    steady = open_service()
    run(steady, work(told[0] + told[1], -1, 1))
    assert steady.cursor == 1
    expected = run(steady, work(told[2] + told[3], 1, 3))
    restarted = open_service()
    assert restarted.cursor == -1
    everything = [outcome for outcomes in told for outcome in outcomes]
    assert run(restarted, work(everything, -1, 3)) == expected
    assert run(restarted, work([], 3, 3)) == expected, "a lease given twice must give the same"
    assert [case.origin.index for case in expected.test_cases] == list(range(12))
    assert {case.origin.round for case in expected.test_cases} == {7}


def test_an_unknown_strategy_is_refused_with_the_choice() -> None:
    with pytest.raises(Refused, match="random_boxes"):
        registry.load_strategy("random_boxs")


def test_draws_are_numpy_free_numbers() -> None:
    """Test cases travel as plain numbers: a numpy scalar would not encode."""
    for name in NAMES:
        for case in asked(make(name)):
            for box in case.scenario.obstacles:
                assert all(type(value) is float for value in msgspec.structs.astuple(box))
            for stimulus in case.stimuli:
                assert all(type(value) is float for value in (stimulus.at_s, *stimulus.values))
                assert np.isfinite(stimulus.values).all()
