"""A farm that is full: no key takes the places of others, and nobody is sent away for good."""

from __future__ import annotations

from collections import Counter

import pytest

from saflite.campaign.engine import worker_registry
from saflite.campaign.engine.worker_registry import FULL, Worker, WorkerRegistry
from saflite.contract.join import Join
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Stage

PLACES = 12


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> WorkerRegistry:
    monkeypatch.setattr(worker_registry, "WORKERS_MAX", PLACES)
    return WorkerRegistry()


def _join(
    registry: WorkerRegistry, name: str, owner: str = "", busy: str = "", session: str = "life", stage: Stage = "fly"
) -> str | None:
    """Join as the books do; return who had to leave, or in words why not."""
    card = Join(protocol=PROTOCOL, worker=name, session=session, stage=stage)
    other = registry.in_the_way(card, owner, lambda _: False, lambda one: one.startswith(busy or "/"))
    if isinstance(other, str):
        return other
    if other is not None:
        assert registry.leave(other.stage, other.worker)
    registry.join(card, 0.0, owner)
    return None if other is None else other.worker


def _owners(registry: WorkerRegistry) -> Counter[str]:
    return Counter(one.owner for one in registry.workers())


def test_one_key_may_fill_an_empty_farm_and_gives_way_to_all_others_until_they_have_as_much(
    registry: WorkerRegistry,
) -> None:
    said = [_join(registry, f"eve-{number}", "eve") for number in range(2 * PLACES)]
    assert said == [None] * PLACES + [FULL] * PLACES
    for number in range(PLACES):
        _join(registry, f"lab-{number}", "lab")
    assert _owners(registry) == {"eve": PLACES // 2, "lab": PLACES // 2}
    said = [_join(registry, f"eve-{number}", "eve") for number in range(PLACES, 2 * PLACES)]
    assert said == [FULL] * PLACES, "shares that are equal stay as they are"
    assert len(registry) == PLACES


def test_the_farm_s_own_always_has_a_place_and_gives_none_up(registry: WorkerRegistry) -> None:
    for number in range(PLACES):
        _join(registry, f"eve-{number}", "eve")
    for number in range(PLACES):
        assert str(_join(registry, f"fly-{number}")).startswith("eve-")
    assert _join(registry, "eve-0", "eve") == FULL
    assert _join(registry, "fly-100") == FULL
    assert _owners(registry) == {"": PLACES}


def test_those_that_hold_no_work_leave_first(registry: WorkerRegistry) -> None:
    for number in range(PLACES - 1):
        _join(registry, f"eve-b{number}", "eve")
    _join(registry, "eve-idle", "eve")
    assert _join(registry, "fly-1", busy="eve-b") == "eve-idle"
    assert str(_join(registry, "fly-2", busy="eve-b")).startswith("eve-b")


def test_a_name_of_the_farm_s_own_is_no_key_s_and_is_taken_back_from_one(registry: WorkerRegistry) -> None:
    _join(registry, "host-fly-1")
    assert "in use" in str(_join(registry, "host-fly-1", "host", session="another"))
    assert registry.owner_of("host-fly-1") == ""
    _join(registry, "host-fly-2", "host")
    assert registry.owner_of("host-fly-2") == "host"
    assert _join(registry, "host-fly-2", session="own") == "host-fly-2"
    assert registry.owner_of("host-fly-2") == ""
    assert registry.owner_of("nobody") is None


def test_counts_of_keys_stay_right_however_workers_come_and_go(registry: WorkerRegistry) -> None:
    for life in range(3):
        for number in range(PLACES):
            card = Join(protocol=PROTOCOL, worker=f"eve-{number}", session=f"{life}", stage="fly")
            other = registry.in_the_way(card, "eve", lambda _: True, lambda _: False)
            if isinstance(other, Worker):
                registry.leave(other.stage, other.worker)
            registry.join(card, 0.0, "eve")
    for number in range(PLACES):
        assert registry.leave("fly", f"eve-{number}")
    assert len(registry) == 0
    assert _join(registry, "eve-1", "eve") is None


def test_the_last_of_a_stage_gives_way_last(registry: WorkerRegistry) -> None:
    _join(registry, "lab-model", "lab", stage="score")
    for number in range(1, PLACES):
        _join(registry, f"lab-{number}", "lab")
    left = [_join(registry, f"fly-{number}", busy="lab-1") for number in range(PLACES)]
    assert "lab-model" in left[-2:], "idle most of the time, but nobody else scores"
    assert None not in left
