"""Leases under way and until when they run. Not kept over a restart: every lease then gets its full time again.

The more workers hold one, the longer new leases run: a heartbeat costs the books about as much whatever it says, and
the dead are told by their tokens, not by their silence. What is noticed later is a worker that hangs.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

from saflite.campaign.scheduling.work_keys import WorkKey
from saflite.contract.config import LeaseConfig
from saflite.contract.work import BEATS_PER_LEASE

BEATS_PER_S_MAX = 100.0  # of all workers together
SILENT_LEASES, SILENT_S = 3, 15.0  # a worker not heard of for so many lease times, and so long, has left


@dataclass(slots=True)
class Deadline:
    """Until when a lease runs. `named` once a heartbeat of its worker showed that the grant arrived."""

    key: WorkKey
    epoch: int
    worker: str
    lease_s: float  # what the worker was told, and so how often it sends heartbeats
    until_s: float
    overdue_s: float  # however alive the worker seems, the lease ends here
    named: bool = False
    place: int = 0  # in the order in which leases were granted

    def ended(self) -> tuple[str, Literal["lost", "overdue"]]:
        """Return in words and in one why a lease that is due ended, however late that is seen."""
        if self.until_s >= self.overdue_s:
            return "ran far beyond its time", "overdue"
        return "was not heard of in time", "lost"


class Leases:
    """The deadlines of all leases under way, by the work they are for. `config` says how long they run at least."""

    def __init__(self, config: LeaseConfig) -> None:
        self._config = config
        self._deadlines: dict[WorkKey, Deadline] = {}
        self._held: Counter[str] = Counter()  # by worker
        self._granted = 0
        self._soonest_s = float("inf")  # no lease is due before

    def __len__(self) -> int:
        return len(self._deadlines)

    @property
    def lease_s(self) -> float:
        """How long a lease granted now runs, unless it is prolonged."""
        return self.lease_of(len(self._held))

    def lease_of(self, holders: int) -> float:
        """Return how long leases run of which so many workers hold some, seconds."""
        return max(self._config.lease_s, BEATS_PER_LEASE * holders / BEATS_PER_S_MAX)

    def patience_s(self, workers: int) -> float:
        """Return after what silence one of so many workers has left, seconds."""
        return max(SILENT_LEASES * self.lease_of(workers), SILENT_LEASES * self.beat_s(workers), SILENT_S)

    def beat_s(self, workers: int) -> float:
        """Return how often each of so many workers may send a heartbeat at most, seconds between two."""
        return max(self._config.heartbeat_s, workers / BEATS_PER_S_MAX)

    def begin(self, deadline: Deadline) -> None:
        """Start the clock of a lease."""
        self.end(deadline.key)
        self._granted += 1
        deadline.place = self._granted
        self._deadlines[deadline.key] = deadline
        self._held[deadline.worker] += 1
        self._soonest_s = min(self._soonest_s, deadline.until_s)

    def end(self, key: WorkKey) -> None:
        """Stop the clock of a lease, if it runs."""
        deadline = self._deadlines.pop(key, None)
        if deadline is not None:
            self._held[deadline.worker] -= 1
            if not self._held[deadline.worker]:
                del self._held[deadline.worker]

    def extend(self, key: WorkKey, epoch: int, worker: str, now_s: float) -> bool:
        """Give a lease named in a heartbeat its full time again; False if it is not this worker's any more."""
        deadline = self._deadlines.get(key)
        if deadline is None or deadline.epoch != epoch or deadline.worker != worker:
            return False
        deadline.until_s, deadline.named = min(now_s + deadline.lease_s, deadline.overdue_s), True
        self._soonest_s = min(self._soonest_s, deadline.until_s)
        return True

    def due(self, now_s: float) -> list[Deadline]:
        """Return the leases whose time is up, in order of the text of their keys."""
        if now_s < self._soonest_s:
            return []
        self._soonest_s = min((one.until_s for one in self._deadlines.values()), default=float("inf"))
        return sorted((one for one in self._deadlines.values() if one.until_s <= now_s), key=lambda one: str(one.key))

    def held_by(self, stage: str, worker: str) -> list[Deadline]:
        """Return the leases of one worker, oldest first: workers take them up in that order."""
        mine = (one for one in self._deadlines.values() if one.worker == worker and one.key.stage == stage)
        return sorted(mine, key=lambda one: one.place)

    def holds(self, worker: str) -> bool:
        """Return whether a worker has any lease."""
        return worker in self._held

    def keys(self) -> list[WorkKey]:
        """Return what is leased."""
        return list(self._deadlines)

    def deadline(self, key: WorkKey) -> Deadline | None:
        """Return the deadline of a lease under way."""
        return self._deadlines.get(key)
