"""The table of work to be done: what waits, what is lent to whom as which attempt, and how often it went wrong."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from saflite.campaign.scheduling.work_keys import WorkKey
from saflite.contract.config import LeaseConfig
from saflite.contract.work import Stage, TargetBuild

Order = tuple[int, int, int, int]


@dataclass(slots=True)
class Task:
    """One piece of work until it is done."""

    key: WorkKey
    order: Order
    target: TargetBuild | None = None  # fly only: what must be there to fly it
    avoid: frozenset[str] = frozenset()
    epoch: int = 0
    worker: str = ""  # who holds it now, empty while it waits
    model: str = ""  # score only: the deciding model of the attempt at hand
    instead_of: str = ""  # score only: the model in whose place the embedded scorer is asked from now on
    fault: str = ""  # score only: why it is asked in that place
    holders: dict[int, str] = field(default_factory=dict)
    losses: int = 0
    undelivered: int = 0
    failures: int = 0
    message: str = ""  # what went wrong last
    granted_s: float = 0.0
    catching_up: bool = False  # mutate only: the attempt at hand only tells outcomes

    @property
    def stage(self) -> Stage:
        """The stage whose workers do it."""
        return self.key.stage

    @property
    def waiting(self) -> bool:
        """Whether it may be lent out."""
        return not self.worker


INFRA_PER_ATTEMPT = 3
"""What our side could not run is given up after this many times `attempts_max` tries."""


def is_enough(task: Task, limits: LeaseConfig) -> bool:
    """Return whether a flight was lost, or could not be run, too often to be tried again."""
    return task.losses >= limits.attempts_max or task.failures >= INFRA_PER_ATTEMPT * limits.attempts_max


UNCOUNTED_MAX = 100
"""Attempts at one piece of work that may come to nothing and count as none: far more than workers that stop take.

Each leaves lines in the journal: who asks, hands back and asks again without end would fill the disk.
"""

TOLD_PER_ROUND_MAX = 10
"""Attempts of a mutator that only told it outcomes, for each round there is to tell: strategies that begin anew."""


def is_uncounted_too_often(task: Task) -> bool:
    """Return whether the attempt at hand has to count as lost though its worker gave it back."""
    told_max = TOLD_PER_ROUND_MAX * task.order[0] if task.stage == "mutate" else 0
    return task.epoch - task.losses - task.failures > UNCOUNTED_MAX + told_max


class TaskTable:
    """All work not done yet, per stage in its order."""

    def __init__(self) -> None:
        self._tasks: dict[WorkKey, Task] = {}
        self._queues: dict[str, list[tuple[Order, WorkKey]]] = {}
        self._waiting: dict[str, int] = {}
        self._kinds: Counter[type] = Counter()  # of all there is, by the type of its key
        self._flown_on: Counter[TargetBuild | None] = Counter()  # flights, by what they want to be flown on

    def __len__(self) -> int:
        return len(self._tasks)

    def __iter__(self) -> Iterator[Task]:
        return iter(self._tasks.values())

    def get(self, key: WorkKey) -> Task | None:
        """Return the task, None if there is none (any more)."""
        return self._tasks.get(key)

    def add(self, task: Task) -> None:
        """Take up new work."""
        assert task.key not in self._tasks, f"{task.key} is already to be done"
        self._tasks[task.key] = task
        self._count(task, 1)
        self._enqueue(task)

    def remove(self, key: WorkKey) -> Task:
        """Take out work that is done or given up."""
        task = self._tasks.pop(key)
        self._count(task, -1)
        if task.waiting:
            self._waiting[task.stage] -= 1
        return task

    def lend(self, key: WorkKey, epoch: int, worker: str, at_s: float) -> Task:
        """Note that the work was lent to `worker` as attempt `epoch`."""
        task = self._tasks[key]
        assert task.waiting, f"{key} is lent to {task.worker} already"
        assert epoch == task.epoch + 1, f"{key}: attempt {epoch} after {task.epoch}"
        task.epoch, task.worker, task.granted_s = epoch, worker, at_s
        task.holders[epoch] = worker
        self._waiting[task.stage] -= 1
        return task

    def requeue(self, task: Task) -> None:
        """Let the work wait again."""
        if not task.waiting:
            task.worker = ""
            self._enqueue(task)

    def enqueue_all(self) -> None:
        """Let all that waits stand in its queue, after the tasks were put there as a whole."""
        self._queues, self._waiting, self._kinds, self._flown_on = {}, {}, Counter(), Counter()
        for task in self._tasks.values():
            self._count(task, 1)
            if task.waiting:
                self._enqueue(task)

    def waiting(self, stage: Stage) -> Iterator[Task]:
        """Yield what waits at a stage, in order, cheaply for the first few. Nothing may be added while it runs."""
        queue = self._queues.get(stage, [])
        passed: list[tuple[Order, WorkKey]] = []
        try:
            while queue:
                item = heapq.heappop(queue)
                task = self._tasks.get(item[1])
                if task is None or not task.waiting or task.order != item[0] or (passed and passed[-1] == item):
                    continue
                passed.append(item)
                yield task
        finally:
            for item in passed:
                if (task := self._tasks.get(item[1])) is not None and task.waiting:
                    heapq.heappush(queue, item)

    def waiting_count(self, stage: Stage) -> int:
        """Return how much waits at a stage."""
        return self._waiting.get(stage, 0)

    def count(self, kind: type) -> int:
        """Return how much there is, waiting or lent out, whose key is of a type."""
        return self._kinds[kind]

    @property
    def targets(self) -> set[TargetBuild]:
        """What flights, waiting or lent out, want to be flown on; those left out that want none."""
        return {one for one, count in self._flown_on.items() if one is not None and count}

    def leased(self) -> list[Task]:
        """Return what is lent out."""
        return [task for task in self._tasks.values() if not task.waiting]

    def validate(self) -> None:
        """Assert that counts, queues and attempts agree."""
        waiting: dict[str, int] = {}
        queued = {key for queue in self._queues.values() for _, key in queue}
        for task in self._tasks.values():
            if task.waiting:
                waiting[task.stage] = waiting.get(task.stage, 0) + 1
                assert task.key in queued, f"{task.key} waits but stands in no queue"
            else:
                assert task.holders.get(task.epoch) == task.worker, f"{task.key}: who holds it is unclear"
            assert len(task.holders) == task.epoch, f"{task.key}: attempts do not add up"
        kinds = Counter(type(key) for key in self._tasks)
        assert kinds == self._kinds, "counts by kind are off"  # equal where one counts zero
        targets = {task.target for task in self._tasks.values() if task.stage == "fly"}
        assert targets == set(self._flown_on), "what flights want to be flown on is off"
        assert waiting == {stage: count for stage, count in self._waiting.items() if count}, "waiting counts are off"

    def _count(self, task: Task, sign: int) -> None:
        self._kinds[type(task.key)] += sign
        if task.stage == "fly":
            self._flown_on[task.target] += sign
            if not self._flown_on[task.target]:
                del self._flown_on[task.target]

    def _enqueue(self, task: Task) -> None:
        heapq.heappush(self._queues.setdefault(task.stage, []), (task.order, task.key))
        self._waiting[task.stage] = self._waiting.get(task.stage, 0) + 1
