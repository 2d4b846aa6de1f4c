"""Which leases are due and which workers silent is told without looking at each, and is never told late."""

from __future__ import annotations

import pytest

from saflite.campaign.engine.worker_registry import WorkerRegistry
from saflite.campaign.scheduling.leases import BEATS_PER_S_MAX, Deadline, Leases
from saflite.campaign.scheduling.work_keys import FlyKey
from saflite.contract.config import LeaseConfig
from saflite.contract.join import Join
from saflite.contract.rng import derive
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import BEATS_PER_LEASE


def test_leases_are_due_as_soon_as_their_time_is_up() -> None:
    rng, leases, now_s = derive(1, "leases"), Leases(LeaseConfig()), 0.0
    mirror: dict[FlyKey, Deadline] = {}
    found = 0
    for number in range(2000):
        now_s += float(rng.exponential(0.5))
        key = FlyKey(f"{number:016x}", "search", 0)
        until_s, overdue_s = now_s + float(rng.uniform(1, 9)), now_s + float(rng.uniform(1, 30))
        mirror[key] = Deadline(key, 1, "w", 10.0, until_s, overdue_s)
        leases.begin(mirror[key])
        for other in list(mirror)[:: 1 + int(rng.integers(5))]:
            if rng.random() < 0.2:
                leases.end(other)
                del mirror[other]
            elif rng.random() < 0.5:
                assert leases.extend(other, 1, "w", now_s)
        due = {key for key, one in mirror.items() if one.until_s <= now_s}
        assert {one.key for one in leases.due(now_s)} == due
        found += len(due)
        for one in list(due)[::2]:  # the others are still there the next time
            leases.end(one)
            del mirror[one]
    assert found > 200


def lease(leases: Leases, number: int, now_s: float = 0.0) -> FlyKey:
    """Grant a worker of that number a lease, as long as one runs now; return what it is for."""
    key = FlyKey(f"{number:016x}", "search", 0)
    leases.begin(Deadline(key, 1, f"w{number}", leases.lease_s, now_s + leases.lease_s, 1e9))
    return key


@pytest.mark.parametrize("workers", [1, 20, 100, 256, 1000])
def test_heartbeats_of_all_workers_together_are_no_more_than_the_books_can_take(workers: int) -> None:
    leases = Leases(LeaseConfig())
    for number in range(workers):
        lease(leases, number)
    assert leases.lease_s >= 10.0
    assert workers * BEATS_PER_LEASE / leases.lease_s <= BEATS_PER_S_MAX
    assert workers / leases.beat_s(workers) <= BEATS_PER_S_MAX
    assert leases.beat_s(workers) >= LeaseConfig().heartbeat_s
    for number in range(1, workers):
        leases.end(FlyKey(f"{number:016x}", "search", 0))
    assert leases.lease_s == 10.0, "who is gone counts no more"


def test_a_lease_of_a_crowd_is_kept_by_its_own_heartbeats_when_the_crowd_is_gone() -> None:
    leases = Leases(LeaseConfig())
    for number in range(1000):
        key = lease(leases, number)
    granted_s = leases.lease_of(999)
    for number in range(999):
        leases.end(FlyKey(f"{number:016x}", "search", 0))
    for beat in range(1, 100):
        now_s = beat * granted_s / BEATS_PER_LEASE
        assert leases.due(now_s) == []
        if beat % 4 == 0:  # three in a row are lost
            assert leases.extend(key, 1, "w999", now_s)


def test_one_lease_granted_anew_counts_its_holder_once() -> None:
    leases = Leases(LeaseConfig())
    key = lease(leases, 7)
    leases.begin(Deadline(key, 2, "w8", 10.0, 20.0, 1e9))
    for number in range(300):
        lease(leases, 1000 + number)
    assert leases.lease_s == leases.lease_of(301)


def test_workers_are_silent_as_soon_as_they_were_not_heard_of() -> None:
    rng, registry, now_s, found = derive(1, "silent"), WorkerRegistry(), 0.0, 0
    seen: dict[str, float] = {}
    for number in range(1000):
        now_s += float(rng.exponential(1.0))
        name = f"w{number % 40}"
        if name in seen:
            assert registry.met("fly", name, "", now_s)
        else:
            assert registry.join(Join(protocol=PROTOCOL, worker=name, stage="fly"), now_s)
        seen[name] = now_s
        if rng.random() < 0.2:
            before_s = now_s - float(rng.uniform(20, 60))
            silent = {one for one, at_s in seen.items() if at_s < before_s}
            assert {one.worker for one in registry.silent(before_s)} == silent
            found += len(silent)
            for one in list(silent)[::2]:
                registry.leave("fly", one)
                del seen[one]
        assert registry.count("fly") == len(seen)
    assert found > 20
