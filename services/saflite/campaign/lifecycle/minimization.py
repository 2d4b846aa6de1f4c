"""Flies what the minimizer asks for. Candidates count against no budget and no round waits for them.

The smallest test case that still violates is then flown as a test case of its own, with re-flights and recording.
"""

from __future__ import annotations

from dataclasses import dataclass

from saflite.campaign.engine.core import Core
from saflite.campaign.lifecycle.confirmation import Trial
from saflite.campaign.lifecycle.minimizer import Minimizer
from saflite.campaign.scheduling.tasks import Task, split_key
from saflite.contract.flight import FLOWN_ENDINGS, Flight
from saflite.contract.test_case import TestCase, identity
from saflite.contract.verdict import Violation
from saflite.contract.work import FlyResult, JudgeResult

CANDIDATE = 900
"""Flight index of candidates; so none can be taken for a flight that counts."""


@dataclass(slots=True)
class MinimizationJob:
    """A violation being made smaller."""

    trial: Trial
    violation: Violation
    minimizer: Minimizer


@dataclass(slots=True)
class Candidate:
    """One smaller test case under way."""

    test_case: TestCase
    flight: Flight | None = None


def is_candidate(task: Task) -> bool:
    """Whether the work is part of shrinking and not a flight that counts."""
    return task.stage in ("fly", "judge") and split_key(task.key)[2] == CANDIDATE


class Minimization:
    """All shrinking under way. What one candidate showed is known to all, in whatever order they ask."""

    def __init__(self, core: Core) -> None:
        self._core = core
        self._jobs: list[MinimizationJob] = []
        self._candidates: dict[str, Candidate] = {}
        self._shown: dict[str, frozenset[str]] = {}

    @property
    def jobs(self) -> int:
        """How many violations are being made smaller."""
        return len(self._jobs)

    def candidate(self, name: str) -> Candidate:
        """Return a candidate under way."""
        return self._candidates[name]

    # ---- beginning and end ---------------------------------------------------------------------------------------

    def begin(self, trial: Trial, violation: Violation) -> None:
        """Begin to make a confirmed violation smaller, if the campaign wants that and there is anything to drop."""
        search = self._core.campaign.search
        if search.shrink and trial.purpose == "search" and trial.test_case.stimuli:
            minimizer = Minimizer(trial.test_case, search.shrink_flights_max)
            self._jobs.append(MinimizationJob(trial, violation, minimizer))

    def advance(self) -> list[MinimizationJob]:
        """Ask for the flights every job needs next; returns and forgets the jobs that are done."""
        finished = [job for job in self._jobs if self._is_done(job)]
        self._jobs = [job for job in self._jobs if job not in finished]
        return finished

    def _is_done(self, job: MinimizationJob) -> bool:
        while cases := job.minimizer.ask():
            known = [name for name in map(identity, cases) if name in self._shown]
            if not known:
                for case in cases:
                    self._fly(job, case)
                return False
            for name in known:
                job.minimizer.tell(name, job.violation.policy in self._shown[name])
        return True

    def _fly(self, job: MinimizationJob, test_case: TestCase) -> None:
        name = identity(test_case)
        if name in self._candidates:
            return
        self._candidates[name] = Candidate(test_case)
        order = (job.trial.round, job.trial.rank, CANDIDATE, 0)
        target = test_case.target.name
        self._core.tasks.add(Task(f"fly/{name}/{CANDIDATE}", "fly", order, target=target, purpose="shrink"))

    # ---- what comes back -----------------------------------------------------------------------------------------

    def on_flown(self, task: Task, result: FlyResult) -> None:
        """Have the flight of a candidate judged."""
        core, flight = self._core, result.flight
        if flight.ending not in FLOWN_ENDINGS:
            self.on_trouble(task, flight.ending, flight.message)
            return
        core.done(task, flight.ending, flight.message)
        core.counts.shrink_flights += 1
        self._candidates[flight.test_case].flight = flight
        core.hold_trace(flight.trace_digest)
        facts = (flight.simulated_s, flight.wall_s, flight.trace_digest, flight.worker, flight.message)
        core.out.row("flights", flight.test_case, CANDIDATE, "shrink", flight.ending, *facts)
        key = f"judge/{flight.test_case}/{CANDIDATE}"
        core.tasks.add(Task(key, "judge", (*task.order[:3], 1), purpose="shrink"))

    def on_judged(self, task: Task, result: JudgeResult) -> None:
        """Note which policies a candidate violates."""
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
        """Fly a candidate again whose trace was lost before it was judged."""
        name = split_key(task.key)[1]
        self._core.done(task, "trace_missing", message)
        self._let_go(name)
        key = f"fly/{name}/{CANDIDATE}"
        target = self._candidates[name].test_case.target.name
        self._core.tasks.add(Task(key, "fly", (*task.order[:3], 0), target=target, purpose="shrink"))

    def _show(self, name: str, violated: frozenset[str]) -> None:
        self._let_go(name)
        del self._candidates[name]
        self._shown[name] = violated

    def _let_go(self, name: str) -> None:
        candidate = self._candidates[name]
        if candidate.flight is not None:
            self._core.let_go_trace(candidate.flight.trace_digest)
            candidate.flight = None
