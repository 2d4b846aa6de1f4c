"""Work as it is handed out: a task of the table made into the message a worker gets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import msgspec

from saflite.campaign.engine.read_model import ReadModel
from saflite.campaign.engine.reducer import Reducer
from saflite.campaign.engine.worker_registry import WorkerRegistry
from saflite.campaign.scheduling.tasks import Task
from saflite.campaign.scheduling.work_keys import FlyKey, JudgeKey, MutateKey, RecordKey, ScoreKey, WarmKey
from saflite.contract import wire
from saflite.contract.config import SearchConfig
from saflite.contract.errors import Unavailable
from saflite.contract.flight import Flight
from saflite.contract.rng import derive_seed
from saflite.contract.score import EMBEDDED
from saflite.contract.work import (
    FlyWork,
    JudgeWork,
    Lease,
    MutateWork,
    Outcome,
    Receipt,
    ReceiptStatus,
    RecordWork,
    Report,
    ScoreWork,
    WarmWork,
    Work,
)

GRANT_MAX_BYTES = 8 * 2**20
TOLD_MAX_BYTES = 16 * 2**20

RECENT_MAX = 3000
"""Outcomes that scorers learn from at most, the latest ones, without their tracks."""

RECENT_STEPS = 3
"""What scorers learn from begins anew once per this share of RECENT_MAX: what a model worked out holds for a while."""

OUTCOMES_MAX = 1000
"""Outcomes in one message; a mutator that has more to be told is told in several leases (`count` 0)."""


class Told(NamedTuple):
    """Outcomes of the rounds after `from_cursor` up to `cursor`."""

    outcomes: tuple[Outcome, ...]
    from_cursor: int
    cursor: int


class WorkMessages:
    """Makes work from tasks. Reads the reducer, the read model and the worker registry; changes none of them."""

    def __init__(self, reducer: Reducer, read_model: ReadModel, registry: WorkerRegistry) -> None:
        self._reducer, self._core, self._read_model, self._registry = reducer, reducer.core, read_model, registry
        self._recent_bytes: dict[int, int] = {}  # of what is told of a round, as far as it was asked for

    def work(self, task: Task, cursor: int) -> Work:
        """Return the work of a task for a worker that was told outcomes up to `cursor`.

        Raises:
            Unavailable: the trace that belongs to it cannot be read.
        """
        match task.key:
            case FlyKey():
                return self._fly(task.key)
            case JudgeKey():
                return self._judge(task.key)
            case RecordKey():
                return self._record(task.key)
            case MutateKey():
                return self._mutate(task.key, cursor)
            case WarmKey():
                return self._warm(task.key)
            case ScoreKey():
                return self._score(task, task.key, cursor)

    def model_for(self, task: Task) -> str:
        """Return the deciding model of a score task handed out now, empty for other work."""
        if not isinstance(task.key, ScoreKey):
            return ""
        return EMBEDDED if task.instead_of else self._reducer.scorers.model

    def overdue_s(self, task: Task) -> float:
        """Return how long a lease may run however alive its worker seems."""
        campaign = self._core.campaign
        if task.stage == "fly":
            return 2.0 * campaign.lease.wall_limit_s + campaign.lease.lease_s
        if task.stage == "score":
            models = 1 + len(self._reducer.scorers.shadow)
            return campaign.scorer.load_deadline_s * models + 4.0 * campaign.scorer.deadline_s
        return 300.0

    def _fly(self, key: FlyKey) -> FlyWork:
        limit_s = self._core.campaign.lease.wall_limit_s
        test_case = self._reducer.test_case_of(key)
        noise = key.index  # every flight of a test case has its own, but one that checks the first over again
        may_end = self._core.target.repeats == "bitwise" and key.purpose in ("confirm", "shrunk")
        return FlyWork(
            test_case=test_case,
            flight_index=key.index,
            purpose=key.purpose,
            wall_limit_s=limit_s,
            noise=noise,
            until_s=self._core.trial_of(key).until_s(key.index) if may_end else None,
        )

    def _judge(self, key: JudgeKey) -> JudgeWork:
        flight = self._reducer.flight_of(key)
        self._check_trace(flight)
        campaign = self._core.campaign
        return JudgeWork(
            test_case=self._reducer.test_case_of(key),
            flight=flight,
            policies=campaign.policies,
            policy_texts=campaign.policy_texts,
        )

    def _record(self, key: RecordKey) -> RecordWork:
        job = self._core.records[key]
        self._check_trace(job.flight)
        return RecordWork(
            test_case=job.test_case,
            flight=job.flight,
            judgement=job.judgement,
            violation=job.violation,
            scores=job.scores,
            policy_texts=self._core.campaign.policy_texts,
        )

    def _check_trace(self, flight: Flight) -> None:
        fault = "" if flight.trace is None else self._read_model.blob_fault(flight.trace)
        if fault:
            raise Unavailable(f"trace {flight.trace_digest[:16]} is {fault}")

    def _mutate(self, key: MutateKey, cursor: int) -> MutateWork:
        core, strategy = self._core, self._core.campaign.strategy
        round_ = core.rounds.under_way[key.round]
        target = round_.number - core.rounds.search.lag
        told = self._told(cursor, max(target, -1))
        return MutateWork(
            round=round_.number,
            count=_candidates(core.rounds.search, round_.plan.flights) if told.cursor >= target else 0,
            strategy=strategy.name,
            settings=strategy.settings,
            rng_seed=derive_seed(core.campaign.rng_seed, "mutate", round_.number),
            template=core.template,
            target=core.target,
            policies=core.campaign.policies,
            outcomes=told.outcomes,
            from_cursor=told.from_cursor,
            cursor=told.cursor,
        )

    def _score(self, task: Task, key: ScoreKey, cursor: int) -> ScoreWork:
        """Where the embedded scorer stands in, it is asked alone: who only watches may be what the process died of."""
        core, scorers = self._core, self._reducer.scorers
        round_ = core.rounds.under_way[key.round]
        upto = max(round_.number - core.rounds.search.lag, -1)
        since, after = self._recent_since(upto), cursor if cursor <= upto else -1
        return ScoreWork(
            round=round_.number,
            model=self.model_for(task),
            shadow=() if task.instead_of else scorers.shadow,
            policies=core.campaign.policies,
            policy_texts=core.campaign.policy_texts,
            test_cases=tuple(round_.candidates[name] for name in round_.batches[key.batch]),
            rng_seed=derive_seed(core.campaign.rng_seed, "score", round_.number, key.batch),
            recent=self._recent_in_short(max(after, since), upto),
            since=since,
            from_cursor=after,
            cursor=upto,
            deadline_s=core.campaign.scorer.deadline_s,
            within_s=self._busy_s() if core.campaign.scorer.cascade else None,
        )

    def _busy_s(self) -> float:
        """Return how long the simulators have work yet, shared among the batches that are to be scored.

        A worker may tell any time of a flight; one that takes longer than it may is ended, so no mean is more than that
        (nor less than nothing, where what was told is taken off again and rounding is left).
        """
        flights, batches = self._core.tasks.count(FlyKey), self._core.tasks.count(ScoreKey)
        simulators = self._registry.count("fly")
        mean_s = self._core.counts.wall_s / max(1, self._core.counts.flights + self._core.counts.reflown)
        mean_s = min(max(0.0, mean_s), self._core.campaign.lease.wall_limit_s)
        return round(mean_s * flights / (max(1, simulators) * max(1, batches)), 3)

    def _warm(self, key: WarmKey) -> WarmWork:
        return WarmWork(model=key.model, load_deadline_s=self._core.campaign.scorer.load_deadline_s)

    def _recent_since(self, upto: int) -> int:
        """Return the round after which scorers learn where they may know the rounds up to `upto`.

        It depends on the outcomes alone, never on what a scorer was told before: so all give the same scores, whether
        they were there from the beginning or not.
        """
        span = max(1, RECENT_MAX // self._core.rounds.search.flights_per_round)
        step = max(1, span // RECENT_STEPS)
        first = max(0, -(-(upto + 1 - span) // step)) * step - 1
        self._weigh(first, upto)
        steps = range(first, upto, step)
        for since in (*steps, *range(steps[-1] + 1 if steps else upto, upto)):
            if sum(self._recent_bytes[number] for number in range(since + 1, upto + 1)) <= TOLD_MAX_BYTES:
                return int(since)
        return max(upto - 1, -1)

    def _recent_in_short(self, after: int, upto: int) -> tuple[Outcome, ...]:
        """Return what is told of the rounds in (after, upto], all of which are weighed."""
        recent = self._recent(after, upto)
        fits = sum(self._recent_bytes[number] for number in range(after + 1, upto + 1)) <= TOLD_MAX_BYTES
        return recent if fits else _in_short(recent)

    def _weigh(self, first: int, upto: int) -> None:
        """Note how large the outcomes of the rounds in (first, upto] are."""
        missing = [number for number in range(first + 1, upto + 1) if number not in self._recent_bytes]
        if missing:
            sizes: Counter[int] = Counter()
            for outcome in self._recent(missing[0] - 1, missing[-1]):
                sizes[outcome.round] += len(wire.encode(outcome))
            self._recent_bytes |= {number: sizes[number] for number in missing}

    def _recent(self, after: int, upto: int) -> tuple[Outcome, ...]:
        """Return the outcomes of the rounds in (after, upto] without their courses."""
        outcomes = self._core.rounds.told_between(after, upto)
        if outcomes is None:
            most = max(RECENT_MAX, self._core.rounds.search.flights_per_round)
            outcomes = self._read_model.outcomes(after, upto, most)
        return tuple(msgspec.structs.replace(outcome, track=()) for outcome in outcomes)

    def _told(self, cursor: int, upto: int) -> Told:
        """Return what a mutator at `cursor` is to be told. One that knows too much is told all from the start.

        Where there is more than goes into one message: the earliest, to be followed by the rest.
        """
        after = cursor if cursor <= upto else -1
        held = self._core.rounds.told_between(after, upto)
        if held is not None and len(held) <= OUTCOMES_MAX:
            outcomes, complete = held, True
        else:
            outcomes = self._read_model.outcomes(after, upto, OUTCOMES_MAX)
            complete = len(outcomes) < OUTCOMES_MAX
        kept = _whole_rounds(outcomes, _fitting(outcomes))
        complete = complete and len(kept) == len(outcomes)
        return Told(_in_short(kept), after, upto if complete or not kept else kept[-1].round)


def _fitting(outcomes: tuple[Outcome, ...]) -> int:
    """Return how many of the outcomes, from the first on, go into one message."""
    size_bytes = 0
    for count, outcome in enumerate(outcomes):
        size_bytes += len(wire.encode(outcome))
        if size_bytes > TOLD_MAX_BYTES:
            return count
    return len(outcomes)


def _in_short(outcomes: tuple[Outcome, ...]) -> tuple[Outcome, ...]:
    """Return the outcomes without their courses, and then no more of them than go into one message, if all do not.

    One round is told as a whole: of thousands of flights, or of flights about which an oracle says too much.
    """
    if _fitting(outcomes) == len(outcomes):
        return outcomes
    short = tuple(msgspec.structs.replace(one, track=(), transitions=(), features={}) for one in outcomes)
    return short[: _fitting(short)]


def _whole_rounds(outcomes: tuple[Outcome, ...], count: int) -> tuple[Outcome, ...]:
    """Return the first `count` outcomes without a last round of which some are missing; one round at least."""
    if count == len(outcomes):
        return outcomes
    cut = outcomes[count].round
    whole = tuple(outcome for outcome in outcomes[:count] if outcome.round != cut)
    return whole or tuple(outcome for outcome in outcomes if outcome.round == outcomes[0].round)


def in_one_message(leases: Iterator[Lease]) -> Iterator[Lease]:
    """Yield leases until there is enough for a message: one grant stays far below what a message may be."""
    size_bytes = 0
    for lease in leases:
        yield lease
        size_bytes += len(wire.encode(lease.work))
        if size_bytes > GRANT_MAX_BYTES:
            return


def _candidates(search: SearchConfig, flights: int) -> int:
    """Return how many candidates a round of `flights` flights is chosen from: a small round from fewer."""
    return min(search.candidates_per_round, -(-search.candidates_per_round * flights // search.flights_per_round))


def receipt_for(report: Report, status: ReceiptStatus, message: str = "") -> Receipt:
    """Return the answer to a report."""
    return Receipt(lease_id=report.lease_id, epoch=report.epoch, status=status, message=message)
