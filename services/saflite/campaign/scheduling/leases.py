"""Leases under way and until when they run. Not kept over a restart: every lease then gets its full time again."""

from __future__ import annotations

from dataclasses import dataclass

from saflite.campaign.scheduling.work_keys import WorkKey


@dataclass(slots=True)
class Deadline:
    """Until when a lease runs. `named` once a heartbeat of its worker showed that the grant arrived."""

    key: WorkKey
    epoch: int
    worker: str
    until_s: float
    overdue_s: float  # however alive the worker seems, the lease ends here
    named: bool = False
    place: int = 0  # in the order in which leases were granted


class Leases:
    """The deadlines of all leases under way, by the work they are for."""

    def __init__(self) -> None:
        self._deadlines: dict[WorkKey, Deadline] = {}
        self._granted = 0
        self._soonest_s = float("inf")  # no lease is due before

    def __len__(self) -> int:
        return len(self._deadlines)

    def begin(self, deadline: Deadline) -> None:
        """Start the clock of a lease."""
        self._granted += 1
        deadline.place = self._granted
        self._deadlines[deadline.key] = deadline
        self._soonest_s = min(self._soonest_s, deadline.until_s)

    def end(self, key: WorkKey) -> None:
        """Stop the clock of a lease, if it runs."""
        self._deadlines.pop(key, None)

    def extend(self, key: WorkKey, epoch: int, worker: str, until_s: float) -> bool:
        """Prolong a lease named in a heartbeat; False if it is not this worker's any more."""
        deadline = self._deadlines.get(key)
        if deadline is None or deadline.epoch != epoch or deadline.worker != worker:
            return False
        deadline.until_s, deadline.named = min(until_s, deadline.overdue_s), True
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

    def keys(self) -> list[WorkKey]:
        """Return what is leased."""
        return list(self._deadlines)

    def deadline(self, key: WorkKey) -> Deadline | None:
        """Return the deadline of a lease under way."""
        return self._deadlines.get(key)
