"""Which leases are due and which workers silent is told without looking at each, and is never told late."""

from __future__ import annotations

from saflite.campaign.engine.worker_registry import WorkerRegistry
from saflite.campaign.scheduling.leases import Deadline, Leases
from saflite.campaign.scheduling.work_keys import FlyKey
from saflite.contract.join import Join
from saflite.contract.rng import derive
from saflite.contract.topics import PROTOCOL


def test_leases_are_due_as_soon_as_their_time_is_up() -> None:
    rng, leases, now_s = derive(1, "leases"), Leases(), 0.0
    mirror: dict[FlyKey, Deadline] = {}
    found = 0
    for number in range(2000):
        now_s += float(rng.exponential(0.5))
        key = FlyKey(f"{number:016x}", "search", 0)
        mirror[key] = Deadline(key, 1, "w", now_s + float(rng.uniform(1, 9)), now_s + float(rng.uniform(1, 30)))
        leases.begin(mirror[key])
        for other in list(mirror)[:: 1 + int(rng.integers(5))]:
            if rng.random() < 0.2:
                leases.end(other)
                del mirror[other]
            elif rng.random() < 0.5:
                assert leases.extend(other, 1, "w", now_s + 10.0)
        due = {key for key, one in mirror.items() if one.until_s <= now_s}
        assert {one.key for one in leases.due(now_s)} == due
        found += len(due)
        for one in list(due)[::2]:  # the others are still there the next time
            leases.end(one)
            del mirror[one]
    assert found > 200


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
