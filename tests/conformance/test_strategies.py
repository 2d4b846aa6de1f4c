"""The suite of strategies over every one found by its place, and the service that runs them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from saflite.conformance.kit import Check, findings, name_of
from saflite.conformance.strategies import (
    POLICIES,
    Setup,
    check_strategy,
    layouts_keep_the_rules_of_the_competition,
    rounds_of,
)
from saflite.contract.errors import Refused
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.work import MutateResult, MutateWork, Outcome
from saflite.flight.mission import mission_names
from saflite.mutator import registry
from saflite.mutator.work import open_service
from saflite.simulator_worker.registry import load_target

NAMES = registry.strategy_names()
BOXES = [name for name in NAMES if registry.load_strategy(name).proposes == "obstacles"]


@cache
def reference() -> TargetInfo:
    return load_target("reference").describe()


@cache
def takes_messages() -> TargetInfo:
    return load_target("betaflight_sanitized").describe()


def setup_of(name: str, mission: str = "mission2") -> Setup:
    target = takes_messages() if name == "messages" else reference()
    return Setup(name, registry.load_strategy(name), target, mission)


@pytest.mark.parametrize(
    ("name", "check"),
    [(name, check) for name in NAMES for check in check_strategy(setup_of(name))],
    ids=lambda value: name_of(value) if isinstance(value, Check) else str(value),
)
def test_strategy(name: str, check: Check) -> None:
    assert findings([check]) == []


@pytest.mark.parametrize("name", NAMES)
def test_it_is_described_in_its_file(name: str) -> None:
    assert len(registry.describe(name)) > 80


@pytest.mark.parametrize("mission", mission_names())
@pytest.mark.parametrize("name", BOXES)
def test_layouts_keep_the_rules_of_the_competition(name: str, mission: str) -> None:
    assert list(layouts_keep_the_rules_of_the_competition(setup_of(name, mission))) == []


class Forgetful(registry.load_strategy("random_boxes")):  # type: ignore[misc]
    """Draws from a stream of its own, and remembers that it was asked."""

    def __init__(self, *made_of: object) -> None:
        super().__init__(*made_of)
        self.own = np.random.Generator(np.random.PCG64(1))

    def ask(self, count: int, rng: np.random.Generator) -> list[TestCase]:
        found: list[TestCase] = super().ask(count, self.own)
        return found


def test_a_strategy_with_a_random_stream_of_its_own_is_found_out() -> None:
    broken = {one.check for one in findings(check_strategy(setup_of("random_boxes")._replace(kind=Forgetful)))}
    assert broken == {
        "it_gives_as_many_as_asked_and_the_same_for_the_same_draw",
        "its_state_depends_on_what_it_was_told_alone",
    }


@pytest.mark.parametrize("name", NAMES)
def test_the_service_restarts_from_zero_and_says_the_same(name: str) -> None:
    setup = setup_of(name)
    told = rounds_of(setup.new(), 4)

    def work(outcomes: list[Outcome], from_cursor: int, cursor: int) -> MutateWork:
        return MutateWork(
            round=7,
            count=12,
            strategy=name,
            settings={},
            rng_seed=2,
            template=setup.template(),
            target=setup.target,
            policies=POLICIES[setup.kind.proposes],
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
