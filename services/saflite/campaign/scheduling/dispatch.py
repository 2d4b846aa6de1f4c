"""Small decisions of the books that depend on who is there: who may have which work, what may still be counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from saflite.campaign.engine.core import Core
from saflite.campaign.engine.worker_registry import Worker, WorkerRegistry, can_fly
from saflite.campaign.scheduling.leases import Leases
from saflite.campaign.scheduling.tasks import Task
from saflite.campaign.scheduling.work_keys import MutateKey, ScoreKey, WarmKey, WorkKey, run_and_key
from saflite.campaign.scheduling.work_messages import receipt_for
from saflite.contract.control import Control
from saflite.contract.flight import FLOWN_ENDINGS
from saflite.contract.names import is_label
from saflite.contract.work import Ask, Failure, FlyResult, HandedBack, Receipt, Report, Result

SEEN_LATELY_S = 7.0
"""A worker heard of within this time (or a lease time, if longer) is there: idle ones send a heartbeat each 3 s."""

ASKED_LATELY_S = 15.0
"""A worker that asked within this time goes on asking: a poll waits 5 s, 5 s later its answer is taken for lost."""

ELSEWHERE_MAX = 10
"""After so many attempts of a key's workers, or of the farm's own, work is kept for none of them any more: others that
take it and do nothing must not keep it."""

SHADOWS_MAX = 16  # models that only watch
AVOIDED_MAX = 32  # re-flights a worker may not have that are looked past when it asks


def _are_models(text: str) -> bool:
    names = text.split(",")
    return len(set(names)) == len(names) <= SHADOWS_MAX and all(is_label(name) for name in names)


class Dispatch:
    """Reads the core and who is there; changes neither."""

    def __init__(self, core: Core, registry: WorkerRegistry, leases: Leases) -> None:
        self._core, self._registry, self._leases = core, registry, leases

    def choose(self, ask: Ask, many: int, now: float) -> list[Task]:
        """Return up to `many` tasks this worker may have, in order."""
        if self._core.state == "paused" and ask.stage in ("mutate", "score", "fly"):
            return []
        if self._core.failed and ask.stage == "mutate":
            return []
        chosen: list[Task] = []
        passed = 0
        for task in self._core.tasks.waiting(ask.stage):
            if self._may_have(ask, task, now):
                chosen.append(task)
            else:
                passed += 1
            if len(chosen) >= many or passed >= AVOIDED_MAX:
                break
        return chosen

    def _may_have(self, ask: Ask, task: Task, now: float) -> bool:
        if not can_fly(ask.targets, task.target):
            return False
        key_failed = self._key_failed(task, ask.worker)
        if ask.worker in task.avoid or key_failed:
            on_their_way = (ask.stage == "fly" or key_failed) and self._is_early(now)
            return not on_their_way and not any(self._untried(task, ask.worker, now))
        if not (task.avoid and isinstance(task.key, MutateKey)):
            return True
        mine = self._registry.get(ask.stage, ask.worker)  # what one could not propose, the longest there tries next
        return mine is None or all(mine.joined_s <= other.joined_s for other in self._untried(task, ask.worker, now))

    def passes_on(self, task: Task, now: float) -> bool:
        """Whether a mutator that could not propose says nothing of the strategy yet: another has not tried."""
        if not isinstance(task.key, MutateKey):
            return False
        on_their_way = bool(self._registry.key_of(task.stage, task.worker)) and self._is_early(now)
        return on_their_way or any(self._untried(task, task.worker, now))

    def _is_early(self, now: float) -> bool:
        """Whether workers may still be on their way to books that were opened just now, the farm's own above all."""
        return now - self._core.opened_s < self._patience_s

    @property
    def _patience_s(self) -> float:
        return max(self._core.campaign.lease.lease_s, SEEN_LATELY_S)

    def _untried(self, task: Task, worker: str, now: float) -> Iterator[Worker]:
        """Yield the others that did not have this before and may still take it: heard of lately, and work or ask."""
        key, failed = self._registry.key_of(task.stage, worker), self._key_failed(task, worker)
        attempts = Counter(self._registry.key_of(task.stage, holder) for holder in task.holders.values())
        asked_since_s = now - max(self._patience_s, ASKED_LATELY_S)
        for other in self._registry.others(task.stage, worker, task.target, now - self._patience_s):
            comes = other.came_s >= asked_since_s or self._leases.holds(other.worker)
            if failed:  # whoever joined otherwise tries before, and again: who has a key can have any number of names
                behind = attempts[other.owner] < attempts[key]  # keys that failed all take turns
                tries = other.owner != key and (behind or not self._key_failed(task, other.worker))
            else:
                tries = other.worker not in task.avoid and not self._key_failed(task, other.worker)
            if comes and tries and attempts[other.owner] < ELSEWHERE_MAX:
                yield other

    def _key_failed(self, task: Task, worker: str) -> bool:
        """Whether some mutator that joined by the same key as this one failed at a task; those without are apart."""
        key = self._registry.key_of("mutate", worker) if isinstance(task.key, MutateKey) else ""
        return bool(key) and any(self._registry.key_of("mutate", other) == key for other in task.avoid)

    def claim(self, report: Report, run: str) -> Task | Receipt:
        """Return the work of run `run` that a report may answer, or what it is told instead."""
        run_id, key = run_and_key(report.lease_id)
        if run_id != run:
            return receipt_for(report, "refused", f"the lease is of run {run_id[:32]!r}, this is {run!r}")
        task = None if key is None else self._core.tasks.get(key)
        if task is None:
            was_done = key is not None and self._was_done(key)
            return receipt_for(report, "duplicate" if was_done else "stale")
        current = task.epoch == report.epoch and task.worker == report.worker
        held = task.holders.get(report.epoch) == report.worker
        return task if current or (held and self._may_merge(report.result)) else receipt_for(report, "stale")

    def _may_merge(self, result: Result) -> bool:
        """Whether a result that comes after its lease has ended still is as good as one in time."""
        if isinstance(result, FlyResult):
            return result.flight.ending in FLOWN_ENDINGS
        return not isinstance(result, Failure | HandedBack)

    def _was_done(self, key: WorkKey) -> bool:
        """Whether this work was done before, as far as can be told."""
        if isinstance(key, MutateKey | ScoreKey):
            return 0 <= key.round < self._core.rounds.planned
        return isinstance(key, WarmKey) or key.test_case in self._core.flown

    def objection(self, control: Control, scorer: str) -> str:
        """Return why an order cannot be taken, empty if it can."""
        core = self._core
        if control.verb == "budget":
            least = core.counts.flights + core.rounds.outstanding()
            if control.number < least:
                fix = "`saflite control stop` ends a campaign that runs"
                return f"budget: expected at least {least} (flown or planned already), got {control.number}; {fix}"
        if control.verb == "scorer" and not control.text:
            return "scorer: expected the name of a model, got nothing"
        if control.verb == "scorer" and control.text == scorer:
            return f"scorer: {scorer} decides already"
        if control.verb in ("scorer", "shadow") and not _are_models(control.text):
            return (
                f"{control.verb}: expected different names of at most {SHADOWS_MAX} models, got {control.text[:80]!r}"
            )
        if control.verb == "resume" and core.state == "running":
            return "resume: the campaign is running already"
        if control.verb in ("pause", "stop") and core.state == "ended":
            return f"{control.verb}: the campaign has ended"
        return ""

    def waiting(self) -> Iterator[tuple[str, int]]:
        """Yield how much waits or is lent out, per stage."""
        for stage in ("mutate", "score", "fly", "judge", "record"):
            yield stage, sum(1 for task in self._core.tasks if task.stage == stage)
