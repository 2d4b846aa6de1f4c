"""The campaign at a glance: exact counts from the reducer, rates over the last minute."""

from __future__ import annotations

from collections import deque

from saflite.campaign.engine.core import Core
from saflite.campaign.engine.reducer import Reducer
from saflite.campaign.engine.worker_registry import Worker, WorkerRegistry
from saflite.campaign.scheduling.leases import Leases
from saflite.contract.bounds import WORD_CHARS_MAX, told
from saflite.contract.control import ArmStanding, Exposed, Status, WorkerStatus
from saflite.contract.work import FlyResult, Result

WINDOW_S = 60.0
LOSSES_TOLD = 2  # attempts lost in a row from which it is told: one alone is a worker that was ended
TROUBLE_CHARS_MAX = 500


class Rates:
    """Flights of the last minute. Not kept over a restart."""

    def __init__(self) -> None:
        self._flights: deque[tuple[float, float]] = deque()
        self._first_s: float | None = None

    def settled(self, result: Result, now: float) -> None:
        """Count a flight."""
        if isinstance(result, FlyResult):
            self._flights.append((now, result.flight.simulated_s))

    def tick(self, now: float) -> None:
        """Forget what is older than the window."""
        if self._first_s is None:
            self._first_s = now
        while self._flights and self._flights[0][0] < now - WINDOW_S:
            self._flights.popleft()

    def rates(self, now: float) -> tuple[float, float]:
        """Return flights per second, and simulated seconds per second over all workers."""
        since_s = now - WINDOW_S if self._first_s is None else max(self._first_s, now - WINDOW_S)
        over_s = max(now - since_s, 1e-3)
        recent = [simulated_s for at_s, simulated_s in self._flights if at_s >= since_s]
        return len(recent) / over_s, sum(recent) / over_s


def _exposed(core: Core) -> Exposed:
    exposure, policies = core.exposure, core.campaign.policies
    silent = tuple(name for name in policies if not exposure.applied[name])
    return Exposed(
        spoke=len(policies) - len(silent),
        silent=silent,
        applied_share=round(exposure.applied_share(policies), 4),
        states=len(exposure.states),
        steps=len(exposure.steps),
    )


def _trouble(core: Core) -> str:
    """Return what holds the campaign up though its workers are there: a strategy that is lost again and again."""
    lost = (task for task in core.tasks if task.stage == "mutate" and task.losses >= LOSSES_TOLD)
    if core.state == "ended" or (task := next(lost, None)) is None:
        return ""
    times = f"was lost {task.losses} times in a row with round {task.order[0]}"
    return f"the strategy {core.campaign.strategy.name!r} {times}: {task.message}"[:TROUBLE_CHARS_MAX]


def status_of(reducer: Reducer, registry: WorkerRegistry, leases: Leases, rates: Rates, now: float) -> Status:
    """Return the status of the campaign at `now`."""
    core, counts = reducer.core, reducer.core.counts
    elapsed_s = core.elapsed_s(now)
    flights_per_s, real_time_factor = rates.rates(now)
    queues = dict.fromkeys(("mutate", "score", "fly", "judge", "record"), 0)
    for task in core.tasks:
        queues[task.stage] += 1
    return Status(
        campaign=core.campaign.name,
        state=core.state,
        round=core.rounds.planned,
        budget=core.rounds.budget,
        flights=counts.flights,
        reflown=counts.reflown,
        checked=counts.checked,
        shrink_flights=counts.shrink_flights,
        test_cases=counts.selected,
        candidates=counts.candidates,
        behaviours=counts.behaviours,
        violations_confirmed=counts.confirmed,
        violations_similar=counts.similar,
        violations_flaky=counts.flaky,
        violations_pending=sum(1 for trial in core.all_trials() if trial.judgement is not None),
        quarantined=counts.quarantined,
        unequal=counts.unequal,
        flights_per_s=flights_per_s,
        real_time_factor=real_time_factor,
        processor_s=registry.processor_s,
        sittings=core.incarnation,
        since_last_find_s=None if counts.last_find_s is None else max(0.0, elapsed_s - counts.last_find_s),
        elapsed_s=elapsed_s,
        scorer=reducer.scorers.model,
        scorer_pending=told(",".join(key.model for key in reducer.scorers.pending), WORD_CHARS_MAX),
        fallbacks=counts.fallbacks,
        unscored=counts.unscored,
        fallback_why=counts.fallback_why,
        scores=counts.scores[reducer.scorers.model],
        scores_by_model=counts.scores_by_model[reducer.scorers.model],
        queues=queues,
        workers=tuple(
            _worker(worker, len(leases.held_by(worker.stage, worker.worker)), core.template.target.name, now)
            for worker in registry.workers()
        ),
        seq=core.out.seq,
        exposure=_exposed(core),
        trouble=_trouble(core),
        arms=tuple(
            ArmStanding(arm=arm, flights=counts.flights, founded=counts.founded)
            for arm, counts in sorted(core.arms.items())
        ),
    )


def _worker(worker: Worker, leases: int, target: str, now: float) -> WorkerStatus:
    return WorkerStatus(
        worker=worker.worker,
        stage=worker.stage,
        state=worker.state,
        leases=leases,
        done=worker.done,
        busy_share=worker.busy_share,
        silent_s=max(0.0, now - worker.seen_s),
        resident_mib=worker.resident_mib,
        host=worker.card.host,
        build=worker.card.build_of(target),
        cores=worker.card.cores,
        labels=worker.card.labels,
    )
