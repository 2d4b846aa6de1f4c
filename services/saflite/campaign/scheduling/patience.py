"""Work that nobody comes to do: noticed, told, and in the end given up, so that a campaign does not wait for ever."""

from __future__ import annotations

from saflite.campaign.engine.core import Core
from saflite.campaign.engine.journal import GaveUp, Noted
from saflite.campaign.engine.worker_registry import Worker, WorkerRegistry, can_fly
from saflite.campaign.scheduling.leases import Leases
from saflite.campaign.scheduling.work_keys import FlyKey
from saflite.contract.events import FaultSeen
from saflite.contract.work import Stage, TargetBuild

BUILD_PATIENCE_S = 60.0
"""How long a build may be missing while other workers are there to fly."""

RECORD_PATIENCE_S = 60.0
"""How long recordings wait for a recorder once they are all there is left to do."""

CHECK_S = 1.0

Entries = list[GaveUp | Noted]


class Patience:
    """Remembers since when somebody is missing. Not kept over a restart."""

    def __init__(self, core: Core, registry: WorkerRegistry, leases: Leases) -> None:
        self._core, self._registry, self._leases = core, registry, leases
        self._missing_since: dict[TargetBuild, float] = {}
        self._told: set[TargetBuild] = set()
        self._no_recorder_since: float | None = None
        self._next_s = 0.0

    def lost(self, now: float) -> Entries:
        """Return what is to be told and given up now."""
        if now < self._next_s:
            return []
        self._next_s = now + CHECK_S
        return [*self._flights(now), *self._recordings(now)]

    def _at_work(self, stage: Stage, since_s: float) -> list[Worker]:
        """Return the workers of a stage that hold work, or have come for some since; others may hang, alive or not."""
        there = (worker for worker in self._registry.workers() if worker.stage == stage)
        return [worker for worker in there if worker.came_s >= since_s or self._leases.holds(worker.worker)]

    def _flights(self, now: float) -> Entries:
        """Return re-flights on a build that no worker has any more; first flights wait on, and their want is told once.

        While nobody flies at all, nothing is given up: workers may be on their way.
        """
        flyers = [worker.targets for worker in self._at_work("fly", now - BUILD_PATIENCE_S)]
        if all(any(can_fly(has, one) for has in flyers) for one in self._core.tasks.targets):
            self._missing_since = {}
            return []
        waiting = self._waiting()
        missing = [one for one in set(waiting.values()) if flyers and not any(can_fly(has, one) for has in flyers)]
        self._missing_since = {one: self._missing_since.get(one, now) for one in missing}
        late = {one for one, since_s in self._missing_since.items() if now - since_s > BUILD_PATIENCE_S}
        firsts = {one for key, one in waiting.items() if one in late and key.purpose == "search"} - self._told
        self._told |= firsts
        told = (FaultSeen(where="fly", message=f"first flights wait: {_said(one)}") for one in sorted(firsts))
        return [
            *(Noted(fact=fact) for fact in told),
            *(
                GaveUp(key=key, message=_said(one))
                for key, one in waiting.items()
                if one in late and key.purpose != "search"
            ),
        ]

    def _waiting(self) -> dict[FlyKey, TargetBuild]:
        return {
            task.key: task.target
            for task in self._core.tasks
            if task.waiting and isinstance(task.key, FlyKey) and task.target is not None and task.target.build
        }

    def _recordings(self, now: float) -> Entries:
        """Return the recordings nobody came to write, where nothing else is left to do."""
        core = self._core
        only_records = bool(core.records) and not core.is_searching and core.rounds.planned > 0
        if not only_records or self._at_work("record", now - RECORD_PATIENCE_S):
            self._no_recorder_since = None
            return []
        self._no_recorder_since = self._no_recorder_since or now
        if now - self._no_recorder_since <= RECORD_PATIENCE_S:
            return []
        return [GaveUp(key=key, message="no recorder came") for key in sorted(core.records)]


def _said(target: TargetBuild) -> str:
    return f"no worker has build {target.build[:16]} of {target.name}"
