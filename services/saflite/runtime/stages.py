"""Opens the service of each stage: the one place that knows what every slice wants to be handed."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from saflite.contract.clock import Clock
from saflite.contract.errors import Refused
from saflite.contract.service import Service
from saflite.contract.work import Stage
from saflite.runtime.worker import Habits

PREFETCH: dict[Stage, int] = {"fly": 1, "judge": 1, "record": 1}
"""Leases held ready beyond the one being worked. Stages with a memory of outcomes take one at a time: each of their
leases carries the outcomes since the one before."""


class Surroundings(NamedTuple):
    """What a service may need of the process it runs in."""

    worker: str
    clock: Clock
    run_dir: Path | None
    target_files: tuple[Path, ...] = ()


def habits_of(stage: Stage, worker: str, service: Service) -> Habits:
    """Return how a worker of this stage works."""
    targets: tuple[str, ...] = ()
    if stage == "fly":
        from saflite.simulator_worker.work import Flyer  # noqa: PLC0415

        assert isinstance(service, Flyer)
        targets = service.targets()
    return Habits(worker, stage, parallel=service.parallel, prefetch=PREFETCH.get(stage, 0), targets=targets)


def open_stage(stage: Stage, around: Surroundings) -> Service:
    """Return the service of a stage; imports only what that stage needs."""
    if stage == "mutate":
        return _mutator()
    if stage == "score":
        return _scorer(around)
    if stage == "fly":
        from saflite.simulator_worker import work as flyer  # noqa: PLC0415

        return flyer.open_service(around.worker, around.clock, around.target_files)
    if stage == "judge":
        return _oracle()
    return _recorder(around)
