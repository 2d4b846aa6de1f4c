"""Flies what the shrinker asks for. Experiments count against no budget and no round waits for them.

The smallest test case that still violates is then flown as a test case of its own, with re-flights and recording.
"""

from __future__ import annotations

from dataclasses import dataclass

from saflite.campaign.confirm import Trial
from saflite.campaign.core import Core
from saflite.campaign.leases import Task, split_key
from saflite.campaign.shrink import Shrinker
from saflite.contract.flight import FLOWN_ENDINGS, Flight
from saflite.contract.test_case import TestCase, identity
from saflite.contract.verdict import Violation
from saflite.contract.work import FlyResult, JudgeResult

EXPERIMENT = 900
"""Flight index of experiments; so none can be taken for a flight that counts."""


@dataclass(slots=True)
class Job:
    """A violation being made smaller."""

    trial: Trial
    violation: Violation
    shrinker: Shrinker


@dataclass(slots=True)
class Experiment:
    """One smaller test case under way."""

    test_case: TestCase
    flight: Flight | None = None


def is_experiment(task: Task) -> bool:
    """Whether the work is part of shrinking and not a flight that counts."""
    return task.stage in ("fly", "judge") and split_key(task.key)[2] == EXPERIMENT


class Lab:
    """All shrinking under way. What one experiment showed is known to all, in whatever order they ask."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._jobs: list[Job] = []
        self._experiments: dict[str, Experiment] = {}
        self._shown: dict[str, frozenset[str]] = {}

    @property
    def jobs(self) -> int:
        """How many violations are being made smaller."""
        return len(self._jobs)

    def experiment(self, name: str) -> Experiment:
        """Return an experiment under way."""
        return self._experiments[name]

    # ---- beginning and end ---------------------------------------------------------------------------------------

    def begin(self, trial: Trial, violation: Violation) -> None:
        """Begin to make a confirmed violation smaller, if the campaign wants that and there is anything to drop."""
        search = self._core.campaign.search
        if search.shrink and trial.purpose == "search" and trial.test_case.stimuli:
            shrinker = Shrinker(trial.test_case, search.shrink_flights_max)
            self._jobs.append(Job(trial, violation, shrinker))

    def advance(self) -> list[Job]:
        """Ask for the flights every job needs next; returns and forgets the jobs that are done."""
        finished = [job for job in self._jobs if self._is_done(job)]
        self._jobs = [job for job in self._jobs if job not in finished]
        return finished

    def _is_done(self, job: Job) -> bool:
        while cases := job.shrinker.ask():
            known = [name for name in map(identity, cases) if name in self._shown]
            if not known:
                for case in cases:
                    self._fly(job, case)
                return False
            for name in known:
                job.shrinker.tell(name, job.violation.policy in self._shown[name])
        return True

    def _fly(self, job: Job, test_case: TestCase) -> None:
        name = identity(test_case)
        if name in self._experiments:
            return
        self._experiments[name] = Experiment(test_case)
        order = (job.trial.round, job.trial.rank, EXPERIMENT, 0)
        target = test_case.target.name
        self._core.tasks.add(Task(f"fly/{name}/{EXPERIMENT}", "fly", order, target=target, purpose="shrink"))

    # ---- what comes back -----------------------------------------------------------------------------------------

    def on_flown(self, task: Task, result: FlyResult) -> None:
        """Have the flight of an experiment judged."""
        core, flight = self._core, result.flight
        if flight.ending not in FLOWN_ENDINGS:
            self.on_trouble(task, flight.ending, flight.message)
            return
        core.done(task, flight.ending, flight.message)
        core.counts.shrink_flights += 1
        self._experiments[flight.test_case].flight = flight
        core.hold_trace(flight.trace_digest)
        facts = (flight.simulated_s, flight.wall_s, flight.trace_digest, flight.worker, flight.message)
        core.out.row("flights", flight.test_case, EXPERIMENT, "shrink", flight.ending, *facts)
        key = f"judge/{flight.test_case}/{EXPERIMENT}"
        core.tasks.add(Task(key, "judge", (*task.order[:3], 1), purpose="shrink"))

    def on_judged(self, task: Task, result: JudgeResult) -> None:
        """Note which policies an experiment violates."""
        self._core.done(task, "judged")
        bad = (verdict.policy for verdict in result.judgement.verdicts if verdict.outcome == "violated")
        self._show(result.judgement.test_case, frozenset(bad))

    def on_trouble(self, task: Task, how: str, message: str) -> None:
        """Try again; what cannot be flown or judged shows nothing."""
        task.failures += 1
        if task.failures < self._core.campaign.lease.attempts_max:
            self._core.again(task, how, message)
        else:
            self._core.done(task, how, message)
            self._show(split_key(task.key)[1], frozenset())

    def on_trace_missing(self, task: Task, message: str) -> None:
        """Fly an experiment again whose trace was lost before it was judged."""
        name = split_key(task.key)[1]
        self._core.done(task, "trace_missing", message)
        self._let_go(name)
        key = f"fly/{name}/{EXPERIMENT}"
        target = self._experiments[name].test_case.target.name
        self._core.tasks.add(Task(key, "fly", (*task.order[:3], 0), target=target, purpose="shrink"))

    def _show(self, name: str, violated: frozenset[str]) -> None:
        self._let_go(name)
        del self._experiments[name]
        self._shown[name] = violated

    def _let_go(self, name: str) -> None:
        experiment = self._experiments[name]
        if experiment.flight is not None:
            self._core.let_go_trace(experiment.flight.trace_digest)
            experiment.flight = None
