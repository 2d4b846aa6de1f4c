"""Which workers are there: who has joined and was heard of since. Not kept over a restart, they join again.

Until then their names are kept for them: no key may have one that another, or the farm's own user, joined by.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from saflite.contract.join import Join
from saflite.contract.work import Ask, Heartbeat, TargetBuild

Name = tuple[str, str]  # stage, worker
REMEMBER_S = 300.0
WORKERS_MAX = 1_000  # at a time; each that comes or goes is a line of the journal
LIVES_MAX = 10 * WORKERS_MAX  # that are remembered; a key can have its workers come and go without end
FULL = f"there are as many workers as a farm can have: {WORKERS_MAX}"


@dataclass(slots=True)
class Worker:
    """One worker: what it said when it joined, and what its asks and heartbeats showed since.

    `owner` is the proven name it joined by, empty for the farm's own user.
    """

    worker: str
    stage: str
    seen_s: float
    joined_s: float
    card: Join
    targets: tuple[TargetBuild, ...] = ()
    came_s: float = float("-inf")  # when it last asked for work or held some, in an earlier life, too
    state: str = "idle"
    done: int = 0
    busy_s: float = 0.0
    idle_s: float = 0.0
    simulated_s: float = 0.0
    resident_mib: float = 0.0
    owner: str = ""

    @property
    def busy_share(self) -> float:
        """Share of its time the worker worked, 0..1."""
        total_s = self.busy_s + self.idle_s
        return self.busy_s / total_s if total_s > 0 else 0.0


def can_fly(announced: tuple[TargetBuild, ...], wanted: TargetBuild | None) -> bool:
    """Return whether a worker that announced these targets may be given work on the one wanted.

    A build that is wanted must have been announced; a worker that announced nothing is given anything, and what it
    then flew is looked at.
    """
    if wanted is None or not announced:
        return True
    return any(wanted.name == one.name and wanted.build in ("", one.build) for one in announced)


class WorkerRegistry:
    """All workers seen lately."""

    def __init__(self) -> None:
        self._workers: dict[Name, Worker] = {}
        self._counts: Counter[str] = Counter()  # of them, by stage
        self._named: dict[str, Worker] = {}  # who holds a name, whatever the stage
        self._kept_for: dict[str, str] = {}  # names of those who have yet to join again: by which key they had
        self._of_key: Counter[str] = Counter()  # workers of each key
        self._left: dict[Name, Worker] = {}  # gone, but perhaps about to come back
        self._quietest_s = float("-inf")  # everybody there was heard of since
        self._spent_s: dict[tuple[str, str, str], float] = {}  # processor time, of each life heard of lately
        self._spent_before_s = 0.0  # of all other lives together

    @property
    def processor_s(self) -> float:
        """Processor time that all workers there were have told of, seconds."""
        return self._spent_before_s + sum(self._spent_s.values())

    def __len__(self) -> int:
        return len(self._workers)

    @property
    def is_full(self) -> bool:
        """Whether no more can join."""
        return len(self._workers) >= WORKERS_MAX

    def in_the_way(
        self, card: Join, owner: str, gone: Callable[[Join], bool], busy: Callable[[str], bool]
    ) -> Worker | str | None:
        """Return whom a worker of an owner takes the name or the place of, or in words why it cannot join.

        A name is free again once `gone` says of the life that holds it that it has ended; another owner's is only for
        the farm's own to take. In a full farm the key that has most workers gives way, the last of a stage last, first
        one that is not `busy`: to the farm's own whatever they are, to a key that has at least two fewer.
        """
        holder = self._workers.get((card.stage, card.worker)) or self._named.get(card.worker)
        if holder is None and owner and self._kept_for.get(card.worker, owner) != owner:
            return f"worker name {card.worker!r} is kept for whoever had it before the books began anew"
        if holder is None:
            return self._most_dispensable(owner, busy) or FULL if self.is_full else None
        if holder.card.session == card.session:
            return None
        if (holder.owner == owner and gone(holder.card)) or (holder.owner and not owner):
            return holder
        return f"worker name {card.worker!r} is in use by a live {holder.stage} worker on {holder.card.host!r}"

    def _most_dispensable(self, owner: str, busy: Callable[[str], bool]) -> Worker | None:
        whose, most = max(self._of_key.items(), key=lambda one: one[::-1], default=("", 0))
        if most < 1 or (owner and most < self._of_key[owner] + 2):
            return None
        theirs = [one for one in self._workers.values() if one.owner == whose]
        many = Counter(one.stage for one in theirs)
        return min(theirs, key=lambda one: (many[one.stage] == 1, busy(one.worker), -many[one.stage], -one.joined_s))

    def owner_of(self, worker: str) -> str | None:
        """Return by which key a worker joined, empty for the farm's own user; None if nobody has or had that name."""
        known = self._named.get(worker)
        return self._kept_for.get(worker) if known is None else known.owner

    def remember(self, members: Mapping[str, str]) -> None:
        """Keep names for those who had joined before a restart, and by which key."""
        self._kept_for = dict(members)

    def key_of(self, stage: str, worker: str) -> str:
        """Return by which key a worker that is there, or was lately, joined; empty for the farm's own and strangers."""
        known = self._workers.get((stage, worker)) or self._left.get((stage, worker))
        return "" if known is None else known.owner

    def join(self, card: Join, now_s: float, owner: str = "") -> bool:
        """Let a worker in; False if this life of it is there already."""
        known = self._workers.get((card.stage, card.worker))
        if known is not None and known.card.session == card.session:
            known.seen_s = now_s
            return False
        self._kept_for.pop(card.worker, None)
        earlier = self._left.pop((card.stage, card.worker), known)
        came_s = float("-inf") if earlier is None else earlier.came_s
        worker = Worker(card.worker, card.stage, now_s, now_s, card, card.targets, came_s, owner=owner)
        self._workers[card.stage, card.worker] = self._named[card.worker] = worker
        self._of_key[owner] += bool(owner)
        if known is not None:
            self._of_key[known.owner] -= bool(known.owner)
        self._counts[card.stage] += known is None
        return True

    def met(self, stage: str, worker: str, session: str, now_s: float) -> bool:
        """Note a sign of life; False where nobody of that name and session has joined."""
        known = self._workers.get((stage, worker))
        if known is None or known.card.session != session:
            return False
        known.seen_s = now_s
        return True

    def asks(self, ask: Ask, now_s: float) -> bool:
        """Note that a worker asks for work, and for which; False where nobody of that name and session has joined."""
        if not self.met(ask.stage, ask.worker, ask.session, now_s):
            return False
        known = self._workers[ask.stage, ask.worker]
        known.came_s, known.targets = now_s, ask.targets
        return True

    def worked(self, stage: str, worker: str, now_s: float) -> None:
        """Note that a worker held work until now: it is about to ask for more, perhaps in its next life."""
        if (known := self._workers.get((stage, worker))) is not None:
            known.came_s = now_s

    def get(self, stage: str, worker: str) -> Worker | None:
        """Return a worker, None if it is not there."""
        return self._workers.get((stage, worker))

    def leave(self, stage: str, worker: str) -> bool:
        """Note that a worker is gone; False if it was not there. Its leases are the caller's to end."""
        gone = self._workers.pop((stage, worker), None)
        if gone is None:
            return False
        self._counts[stage] -= 1
        if self._named.get(worker) is gone:
            del self._named[worker]
        self._of_key[gone.owner] -= bool(gone.owner)
        self._left.pop((stage, worker), None)
        self._left[stage, worker] = gone
        while (first := next(iter(self._left.values()))).seen_s <= gone.seen_s - REMEMBER_S or len(
            self._left
        ) > LIVES_MAX:
            del self._left[first.stage, first.worker]
        return True

    def workers(self) -> list[Worker]:
        """Return all workers by stage and name."""
        return [self._workers[name] for name in sorted(self._workers)]

    def count(self, stage: str) -> int:
        """Return how many workers of a stage are there."""
        return self._counts[stage]

    def others(self, stage: str, worker: str, target: TargetBuild | None, since_s: float) -> Iterator[Worker]:
        """Yield other workers of a stage that can fly `target` and were seen since `since_s`, even if gone by now."""
        for (their_stage, name), other in (*self._workers.items(), *self._left.items()):
            is_there = other.seen_s >= since_s and other.state != "draining"
            if their_stage == stage and name != worker and is_there and can_fly(other.targets, target):
                yield other

    def silent(self, before_s: float) -> list[Worker]:
        """Return the workers not heard of since `before_s`."""
        if before_s <= self._quietest_s:
            return []
        self._quietest_s = min((worker.seen_s for worker in self._workers.values()), default=before_s)
        return [worker for worker in self._workers.values() if worker.seen_s < before_s]

    def beat(self, beat: Heartbeat, now_s: float) -> None:
        """Take over what a heartbeat says of its worker, which has joined."""
        worker = self._workers[beat.stage, beat.worker]
        worker.state, worker.done = beat.state, beat.done
        worker.busy_s, worker.idle_s = beat.busy_s, beat.idle_s
        worker.simulated_s, worker.resident_mib = beat.simulated_s, beat.resident_mib
        life = beat.stage, beat.worker, beat.session
        self._spent_s.pop(life, None)
        self._spent_s[life] = beat.processor_s
        if len(self._spent_s) > LIVES_MAX:
            self._spent_before_s += self._spent_s.pop(next(iter(self._spent_s)))
