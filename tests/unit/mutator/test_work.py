"""The cursor protocol of the mutate stage."""

from __future__ import annotations

import pytest

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import Scenario, Target, TestCase
from saflite.contract.work import HandedBack, MutateWork
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.mission import builtin_mission
from saflite.mutator.work import open_service

TEMPLATE = TestCase(target=Target(), scenario=Scenario(mission=builtin_mission("mission1")))


def work(from_cursor: int, cursor: int, strategy: str = "random_boxes", rng_seed: int = 1) -> MutateWork:
    return MutateWork(
        round=cursor + 3,
        count=3,
        strategy=strategy,
        settings={},
        rng_seed=rng_seed,
        template=TEMPLATE,
        target=describe(),
        policies=(),
        outcomes=(),
        from_cursor=from_cursor,
        cursor=cursor,
    )


def never() -> bool:
    return False


@pytest.mark.parametrize(("from_cursor", "cursor"), [(0, 4), (3, 4), (2, 1)])
def test_outcomes_that_do_not_join_on_are_asked_for_again_from_the_start(from_cursor: int, cursor: int) -> None:
    service = open_service()
    service.do(work(-1, 2), never)
    with pytest.raises(Unavailable, match="join"):
        service.do(work(from_cursor, cursor), never)
    assert service.cursor == -1
    service.do(work(-1, 4), never)
    assert service.cursor == 4


def test_another_campaign_begins_from_the_start() -> None:
    service = open_service()
    service.do(work(-1, 2), never)
    with pytest.raises(Unavailable):
        service.do(work(2, 3, strategy="deephyperion"), never)
    service.do(work(-1, 3, strategy="deephyperion"), never)
    assert service.cursor == 3


def test_a_cancelled_lease_is_handed_back() -> None:
    assert isinstance(open_service().do(work(-1, -1), lambda: True), HandedBack)


def test_an_unknown_strategy_is_refused() -> None:
    with pytest.raises(Refused, match="strategy"):
        open_service().do(work(-1, 0, strategy="nonsense"), never)
