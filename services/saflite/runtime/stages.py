"""Opens the service of each stage: the one place that knows what every slice wants to be handed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from saflite.contract.blobs import Blobs
from saflite.contract.clock import Clock
from saflite.contract.service import Service
from saflite.contract.work import PolicyTexts, Stage, TargetBuild
from saflite.runtime.worker import WorkerConfig

if TYPE_CHECKING:
    from saflite.scorer_pool.model import PolicyBrief

PREFETCH: dict[Stage, int] = {"fly": 1, "judge": 1, "record": 1}
"""Leases held ready beyond the one being worked. Stages with a memory of outcomes take one at a time: each of their
leases carries the outcomes since the one before."""


class ServiceContext(NamedTuple):
    """What a service may need of the process it runs in."""

    worker: str
    clock: Clock
    run_dir: Path | None
    blobs: Blobs


def worker_config(stage: Stage, worker: str, service: Service) -> WorkerConfig:
    """Return how a worker of this stage works."""
    targets: tuple[TargetBuild, ...] = ()
    if stage == "fly":
        from saflite.simulator_worker.work import Flyer

        assert isinstance(service, Flyer)
        targets = tuple(TargetBuild(name, build) for name, build in sorted(service.builds().items()))
    return WorkerConfig(worker, stage, parallel=service.parallel, prefetch=PREFETCH.get(stage, 0), targets=targets)


def open_stage(stage: Stage, context: ServiceContext) -> Service:
    """Return the service of a stage, importing only what it needs."""
    if stage == "mutate":
        from saflite.mutator import work as mutator

        return mutator.open_service()
    if stage == "score":
        from saflite.scorer_pool import work as scorer_pool

        transcript = context.run_dir / "logs" / f"{context.worker}.transcript.jsonl" if context.run_dir else None
        return scorer_pool.open_service(brief_of, context.clock, transcript)
    if stage == "fly":
        from saflite.simulator_worker import work as flyer

        return flyer.open_service(context.worker, context.clock, context.blobs, verify=True)
    if stage == "judge":
        from saflite.oracle import work as oracle

        return oracle.open_service(context.blobs)
    from saflite.recorder import work as recorder

    return recorder.open_service(context.blobs, context.clock)


def brief_of(name: str, texts: PolicyTexts | None = None) -> PolicyBrief:
    """Return what scorers are told of a policy; raises Refused for an unknown one."""
    from saflite.oracle.policy import check_told, load_policy
    from saflite.scorer_pool.model import PolicyBrief

    check_told((name,), texts or {})
    file = load_policy(name, texts).file
    inputs = file.inputs
    names = (*inputs.parameters, *inputs.commands, *inputs.sticks, *inputs.modes, *inputs.sensor_faults)
    obstacles = ("obstacles",) if inputs.obstacles else ()
    return PolicyBrief(name, file.interestingness, tuple(file.signals), file.state, (*obstacles, *names))
