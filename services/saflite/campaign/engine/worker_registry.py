"""Who is there and until when leases run: the part of the books that is not kept over a restart."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from saflite.campaign.scheduling.work_keys import WorkKey
from saflite.contract.work import Heartbeat

Name = tuple[str, str]  # stage, worker
REMEMBER_S = 300.0


@dataclass(slots=True)
class Worker:
    """One worker as seen by its asks and heartbeats."""

    worker: str
    stage: str
    seen_s: float
    joined_s: float
    targets: tuple[str, ...] = ()
    state: str = "idle"
    done: int = 0
    busy_s: float = 0.0
    idle_s: float = 0.0
    simulated_s: float = 0.0
    resident_mib: float = 0.0
    leases: set[WorkKey] = field(default_factory=set)

    @property
    def busy_share(self) -> float:
        """Share of its time the worker worked, 0..1."""
        total_s = self.busy_s + self.idle_s
        return self.busy_s / total_s if total_s > 0 else 0.0


@dataclass(slots=True)
class Deadline:
    """Until when a lease runs. `named` once a heartbeat of its worker showed that the grant arrived."""

    key: WorkKey
    epoch: int
    stage: str
    worker: str
    until_s: float
    overdue_s: float  # however alive the worker seems, the lease ends here
    named: bool = False
    place: int = 0  # in the order in which leases were lent out


class WorkerRegistry:
    """All workers seen lately and all leases under way."""

    def __init__(self) -> None:
        self._workers: dict[Name, Worker] = {}
        self._left: dict[Name, Worker] = {}  # gone, but perhaps about to come back
        self._deadlines: dict[WorkKey, Deadline] = {}
        self._lent = 0

    def meet(self, stage: str, worker: str, now_s: float) -> bool:
        """Note a sign of life; True if the worker is new."""
        known = self._workers.get((stage, worker))
        if known is None:
            self._left.pop((stage, worker), None)
            self._workers[stage, worker] = Worker(worker, stage, now_s, now_s)
            return True
        known.seen_s = now_s
        return False

    def get(self, stage: str, worker: str) -> Worker | None:
        """Return a worker, None if it is not there."""
        return self._workers.get((stage, worker))

    def leave(self, stage: str, worker: str) -> bool:
        """Note that a worker is gone; False if it was not there. Its leases are the caller's to end."""
        gone = self._workers.pop((stage, worker), None)
        if gone is None:
            return False
        self._left = {name: one for name, one in self._left.items() if one.seen_s > gone.seen_s - REMEMBER_S}
        self._left[stage, worker] = gone
        return True

    def workers(self) -> list[Worker]:
        """Return all workers by stage and name."""
        return [self._workers[name] for name in sorted(self._workers)]

    def others(self, stage: str, worker: str, target: str, since_s: float) -> Iterator[str]:
        """Yield other workers of a stage that can fly `target` and were seen since `since_s`, even if gone by now."""
        for (their_stage, name), other in (*self._workers.items(), *self._left.items()):
            fits = not other.targets or not target or target in other.targets
            if (
                their_stage == stage
                and name != worker
                and fits
                and other.seen_s >= since_s
                and other.state != "draining"
            ):
                yield name

    def silent(self, before_s: float) -> list[Worker]:
        """Return the workers not heard of since `before_s`."""
        return [worker for worker in self._workers.values() if worker.seen_s < before_s]

    def beat(self, beat: Heartbeat, now_s: float) -> None:
        """Take over what a heartbeat says of its worker."""
        self.meet(beat.stage, beat.worker, now_s)
        worker = self._workers[beat.stage, beat.worker]
        worker.state, worker.done = beat.state, beat.done
        worker.busy_s, worker.idle_s = beat.busy_s, beat.idle_s
        worker.simulated_s, worker.resident_mib = beat.simulated_s, beat.resident_mib

    # ---- leases --------------------------------------------------------------------------------------------------

    def begin(self, deadline: Deadline) -> None:
        """Start the clock of a lease."""
        self._lent += 1
        deadline.place = self._lent
        self._deadlines[deadline.key] = deadline
        worker = self._workers.get((deadline.stage, deadline.worker))
        if worker is not None:
            worker.leases.add(deadline.key)

    def end(self, key: WorkKey) -> None:
        """Stop the clock of a lease."""
        deadline = self._deadlines.pop(key, None)
        if deadline is not None:
            worker = self._workers.get((deadline.stage, deadline.worker))
            if worker is not None:
                worker.leases.discard(key)

    def extend(self, key: WorkKey, epoch: int, worker: str, until_s: float) -> bool:
        """Prolong a lease named in a heartbeat; False if it is not this worker's any more."""
        deadline = self._deadlines.get(key)
        if deadline is None or deadline.epoch != epoch or deadline.worker != worker:
            return False
        deadline.until_s, deadline.named = min(until_s, deadline.overdue_s), True
        return True

    def due(self, now_s: float) -> list[Deadline]:
        """Return the leases whose time is up, in order of their keys."""
        return sorted((one for one in self._deadlines.values() if one.until_s <= now_s), key=lambda one: str(one.key))

    def next_s(self) -> float | None:
        """Return when the next lease ends, None if none is under way."""
        return min((one.until_s for one in self._deadlines.values()), default=None)

    def held_by(self, stage: str, worker: str) -> list[Deadline]:
        """Return the leases of one worker, oldest first: workers take them up in that order."""
        mine = (one for one in self._deadlines.values() if one.worker == worker and one.stage == stage)
        return sorted(mine, key=lambda one: one.place)

    def keys(self) -> list[WorkKey]:
        """Return what is lent out."""
        return list(self._deadlines)

    def deadline(self, key: WorkKey) -> Deadline | None:
        """Return the deadline of a lease under way."""
        return self._deadlines.get(key)

    def __len__(self) -> int:
        return len(self._deadlines)
