"""From an empty round to scored candidates: what the mutator proposes and what scorers say of it."""

from __future__ import annotations

import msgspec

from saflite.campaign.engine.core import Core
from saflite.campaign.engine.journal import Selected
from saflite.campaign.lifecycle.flights import Flights
from saflite.campaign.scheduling.rounds import Round
from saflite.campaign.scheduling.tasks import Task
from saflite.campaign.scheduling.work_keys import MutateKey, ScoreKey
from saflite.contract.bounds import WORD_CHARS_MAX, told
from saflite.contract.events import Proposed, Scored
from saflite.contract.score import EMBEDDED, UNSCORED, Score
from saflite.contract.test_case import identity
from saflite.contract.work import MutateResult, ScoreResult

MUTATE_FAILURES_MAX = 5

MUTATE_LOSSES_MAX = 10
"""Attempts at one round that may be lost in a row: far more than kills and scaling down take, each of a few seconds."""

SCORE_FAULTS_MAX = 2
"""Attempts at a batch that the scorer may lose or fail; then the embedded scorer is asked in its place."""

EMBEDDED_FAULTS_MAX = 10
"""Attempts that the embedded scorer may lose besides: far more than kills take. Then the test cases are not scored."""

FALLBACK_SCORE = 5.0


class Proposals:
    """Plans rounds, takes proposals and scores, and hands selected test cases on to be flown."""

    def __init__(self, core: Core, flights: Flights) -> None:
        self._core, self._flights = core, flights

    def advance(self) -> None:
        """Plan every round that may be planned now, and end the campaign when nothing is left to do."""
        core = self._core
        while core.state == "running" and core.rounds.may_plan():
            plan = core.rounds.next_plan()
            if plan is None:
                break
            round_ = core.rounds.open(plan)
            if not plan.flights:
                core.rounds.close(round_.number)
                continue
            core.tasks.add(Task(MutateKey(round_.number), (round_.number, 0, 0, 0)))
        self._if_over()

    def _if_over(self) -> None:
        core = self._core
        left_open = ("score", "mutate") if core.failed else ("score",)
        if core.state != "running" or core.is_searching or any(task.stage not in left_open for task in core.tasks):
            return
        if core.counts.flights >= core.rounds.budget:
            core.change_state("ended", "the budget is spent")
        else:
            core.change_state("ended", core.failed or "the strategy proposes nothing new", failed=bool(core.failed))

    def ask_again(self) -> None:
        """Let a strategy that failed be asked anew for the round that it failed at, as often as at first."""
        core = self._core
        if not core.failed:
            return
        core.failed = ""
        for task in core.tasks:
            if isinstance(task.key, MutateKey):
                task.failures = task.losses = 0

    # ---- mutants -------------------------------------------------------------------------------------------------

    def on_mutated(self, task: Task, result: MutateResult) -> None:
        """Take the test cases proposed for a round; doubles and those the strategy was told of are left out.

        Test cases of the rounds in between are left out when flights are chosen: which of those are known by now
        depends on timing.
        """
        core = self._core
        known_upto = result.round - core.rounds.search.lag
        round_ = core.rounds.under_way[result.round]
        core.done(task, "mutated")
        core.failed = ""  # a late result: it could propose, after all
        for index, test_case in enumerate(result.test_cases):
            name = identity(test_case)
            if name in round_.candidates or core.flown.get(name, result.round) <= known_upto:
                continue
            origin = msgspec.structs.replace(test_case.origin, round=round_.number, index=index)
            round_.candidates[name] = msgspec.structs.replace(test_case, origin=origin)
            line = core.out.line_count
            core.out.row("test_cases", name, round_.number, index, origin.strategy, origin.parent, line, None)
        core.counts.candidates += len(round_.candidates)
        core.tell(Proposed(round=round_.number, test_cases=tuple(round_.candidates)))
        self._ask_scores(round_)

    def on_mutate_failure(self, task: Task, message: str) -> None:
        """The mutator could not propose: again, and in the end the strategy is asked no more.

        The campaign ends once all that was chosen before has ended: what that is does not depend on timing.
        """
        core = self._core
        task.failures += 1
        core.fault(str(task.key), message)
        core.again(task, "failed", message)
        if task.failures >= MUTATE_FAILURES_MAX:
            core.failed = f"the strategy {core.campaign.strategy.name!r} cannot propose: {message}"

    def on_mutate_lost(self, task: Task, message: str) -> None:
        """The mutator vanished with the work or came to no end: again, and in the end the strategy is asked no more.

        Now and then one is killed; a strategy that hangs, or takes its process down, is lost every time.
        """
        core = self._core
        task.losses += 1
        core.fault(str(task.key), message)
        core.again(task, "lost", message)
        if task.losses >= MUTATE_LOSSES_MAX:
            times = f"was lost {task.losses} times in a row with round {task.order[0]}"
            core.failed = f"the strategy {core.campaign.strategy.name!r} {times}: {message}"

    def _ask_scores(self, round_: Round) -> None:
        core, size = self._core, self._core.campaign.scorer.batch
        names = list(round_.candidates)
        round_.batches = [tuple(names[start : start + size]) for start in range(0, len(names), size)]
        round_.phase = "scoring"
        for batch in range(len(round_.batches)):
            core.tasks.add(Task(ScoreKey(round_.number, batch), (round_.number, batch, 0, 0)))
        self._if_scored(round_)

    # ---- scores --------------------------------------------------------------------------------------------------

    def on_scored(self, task: Task, key: ScoreKey, result: ScoreResult) -> None:
        """Take exactly one deciding score per candidate of a batch."""
        core = self._core
        round_ = core.rounds.under_way[key.round]
        model = task.instead_of or task.model
        core.done(task, "scored")
        latency_s = max((usage.latency_s for usage in result.usage.values()), default=0.0)
        for label, usage in result.usage.items():
            tokens = (usage.tokens_in, usage.tokens_out, usage.latency_s, usage.cost_usd, usage.calls)
            core.out.row(
                "usage",
                round_.number,
                key.batch,
                label,
                *tokens,
                usage.asked_again,
                usage.cached,
                sum(usage.faults.values()),
            )
        self._scored(round_, model, _in_place_of(task, result.scores), latency_s)

    def _count(self, model: str, deciding: list[Score]) -> None:
        """Count the scores that `model` was to give; of those that another gave instead, keep why."""
        counts, faults = self._core.counts, [score.fault for score in deciding if score.fault]
        counts.scores[model] += len(deciding)
        counts.scores_by_model[model] += sum(1 for score in deciding if score.scored_by == model)
        counts.fallbacks += len(faults)
        counts.unscored += sum(1 for score in deciding if score.scored_by == UNSCORED)
        if faults:
            counts.fallback_why = faults[-1][:200]

    def on_score_overdue(self, task: Task, key: ScoreKey, message: str) -> None:
        """A batch had all the time there is, and its scorer still went on: the embedded one is asked at once.

        Kills and restarts look like a loss, a hang does not: a second time would cost as much again.
        """
        if not task.instead_of:
            task.failures = max(task.failures, SCORE_FAULTS_MAX - 1)
        self.on_score_trouble(task, key, message)

    def on_score_trouble(self, task: Task, key: ScoreKey, message: str) -> None:
        """A batch was lost or failed: once more; after the second time the embedded scorer is asked in its place.

        Which of them is asked follows from how often the batch was lost or failed, whoever had it and when. Where even
        the embedded scorer's process is lost each time, the order suffers and nothing else.
        """
        core = self._core
        task.failures += 1
        core.fault(str(task.key), message)
        if task.failures < SCORE_FAULTS_MAX + EMBEDDED_FAULTS_MAX:
            core.again(task, "failed", message)
            if task.failures == SCORE_FAULTS_MAX:
                task.instead_of, task.model = task.model, EMBEDDED  # what the other says late does not count
                task.fault = message
            return
        round_ = core.rounds.under_way[key.round]
        core.done(task, "failed", message)
        fault = told(message, WORD_CHARS_MAX) or "lost"
        scores = tuple(
            Score(test_case=name, value=FALLBACK_SCORE, model=task.instead_of, scored_by=UNSCORED, fault=fault)
            for name in round_.batches[key.batch]
        )
        self._scored(round_, task.instead_of, scores, 0.0)

    def _scored(self, round_: Round, model: str, scores: tuple[Score, ...], latency_s: float) -> None:
        core = self._core
        self._count(model, [score for score in scores if not score.shadow])
        pairs = []
        for score in scores:
            labels = (score.model, score.scored_by, score.value, int(score.shadow), score.fault, score.reason)
            core.out.row("scores", score.test_case, round_.number, *labels, score.model_digest, score.prompt_digest)
            if not score.shadow:
                assert score.test_case not in round_.scores, f"{score.test_case} is scored twice"
                round_.scores[score.test_case] = score
                pairs.append((score.test_case, score.value))
        fallbacks = sum(1 for score in scores if score.fault and not score.shadow)
        unscored = sum(1 for score in scores if score.scored_by == UNSCORED)
        fact = Scored(round=round_.number, model=model, scores=tuple(pairs), fallbacks=fallbacks, latency_s=latency_s)
        core.tell(msgspec.structs.replace(fact, unscored=unscored))
        self._if_scored(round_)

    def _if_scored(self, round_: Round) -> None:
        if round_.phase == "scoring" and len(round_.scores) == len(round_.candidates):
            round_.phase = "scored"

    # ---- selected ------------------------------------------------------------------------------------------------

    def on_selected(self, entry: Selected) -> None:
        """Hand the flights chosen for a round on; a round without any is closed."""
        core = self._core
        round_ = core.rounds.under_way[entry.round]
        round_.phase = "flying"
        for rank, pick in enumerate(entry.picks):
            self._flights.begin(round_, rank, pick)
        round_.forget_candidates()
        if not entry.picks:
            core.rounds.close(round_.number)


def _in_place_of(task: Task, scores: tuple[Score, ...]) -> tuple[Score, ...]:
    """Return scores that the embedded scorer gave in the place of another as those of the other, and why."""
    if not task.instead_of:
        return scores
    fault = "" if task.instead_of == EMBEDDED else told(task.fault, WORD_CHARS_MAX) or "lost"
    return tuple(msgspec.structs.replace(one, model=task.instead_of, fault=one.fault or fault) for one in scores)
