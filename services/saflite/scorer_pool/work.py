"""The scorer stage: test cases in, one deciding score each out; the embedded scorer answers where a model cannot."""

from __future__ import annotations

import math
import threading
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path

import msgspec

from saflite.contract.bounds import WORD_CHARS_MAX, told
from saflite.contract.clock import Clock
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.contract.outside_code import Raised
from saflite.contract.score import EMBEDDED, SCORE_MAX, SCORE_MIN, Score
from saflite.contract.service import Cancelled
from saflite.contract.test_case import identity
from saflite.contract.work import (
    HandedBack,
    PolicyTexts,
    Result,
    ScoreResult,
    ScoreWork,
    Stage,
    WarmResult,
    WarmWork,
    Work,
)
from saflite.scorer_pool.cascade import Paces, decided, first_by, waits_for_a_server
from saflite.scorer_pool.learning.history import History
from saflite.scorer_pool.llm.transcript import Transcript, TranscriptFile, silent
from saflite.scorer_pool.model import MIDDLE, BriefOf, Job, Model, ModelScore, PolicyBrief, ScoreSheet, Tools
from saflite.scorer_pool.registry import make

PARALLEL_MAX = 8


class ScorerPool:
    """One replica of the pool. Any number of them may run, on any machine; the books decide which model scores."""

    stage: Stage = "score"

    def __init__(self, brief_of: BriefOf, clock: Clock, transcript: Transcript = silent) -> None:
        self._brief_of = brief_of
        self._clock = clock
        self._transcript = transcript
        self._history = History()
        self._models: dict[str, Model] = {}
        self._turn = threading.Lock()
        self._lock = threading.RLock()
        self._load_deadline_s = 300.0
        self._paces = Paces()

    @property
    def cursor(self) -> int:
        """The round up to which outcomes were told; -1 for none."""
        return self._history.cursor

    @property
    def parallel(self) -> int:
        """How many leases may be worked at once: 1 while models compute here, more once one waits for a server."""
        with self._lock:
            return min(PARALLEL_MAX, max((model.parallel for model in self._models.values()), default=1))

    def do(self, work: Work, cancelled: Cancelled) -> Result:
        """Score a batch or warm a model.

        Raises:
            Unavailable: the outcomes told do not join on to those known; ask again.
        """
        if isinstance(work, WarmWork):
            return self._warm(work, cancelled)
        assert isinstance(work, ScoreWork), f"the scorer pool was given {type(work).__name__}"
        result = self._score(work, cancelled)
        return HandedBack(message="cancelled") if cancelled() else result

    def close(self) -> None:
        """Close every model."""
        with self._lock:
            for model in self._models.values():
                model.close()
            self._models.clear()

    # ---- warming -----------------------------------------------------------------------------------------------

    def _warm(self, work: WarmWork, cancelled: Cancelled) -> WarmResult:
        self._load_deadline_s = work.load_deadline_s
        try:
            model = self._model(work.model)
            message = model.warm(cancelled)
        except FarmError as fault:
            self._forget(work.model)
            return WarmResult(model=work.model, ready=False, message=told(str(fault)))
        return WarmResult(model=work.model, ready=True, message=told(message))

    def _model(self, label: str) -> Model:
        with self._lock:
            if label not in self._models:
                self._models[label] = make(
                    label, Tools(self._clock, self._model, self._load_deadline_s, self._transcript)
                )
            return self._models[label]

    def _forget(self, label: str) -> None:
        with self._lock:
            model = self._models.pop(label, None)
        if model is not None:
            model.close()

    # ---- scoring -----------------------------------------------------------------------------------------------

    def _score(self, work: ScoreWork, cancelled: Cancelled) -> ScoreResult:
        self._history.tell(work.recent, work.from_cursor, work.cursor)
        job = Job(
            test_cases=work.test_cases,
            briefs=tuple(self._brief(name, work.policy_texts) for name in work.policies),
            rng_seed=work.rng_seed,
            round=work.round,
            history=self._history.view(work.since, work.cursor),
            cursor=work.cursor,
            deadline_s=work.deadline_s,
            within_s=work.within_s,
            cancelled=cancelled,
        )
        shadows = tuple(dict.fromkeys(label for label in work.shadow if label != work.model))
        if work.within_s is not None and self._waits(work.model):
            return self._cascade(job, work.model, shadows)
        if not shadows:
            return self._result(job, work.model, self._answer(work.model, job), {})
        with ThreadPoolExecutor(len(shadows), thread_name_prefix="shadow") as threads:
            waiting = {label: threads.submit(self._watch, label, job) for label in shadows}
            return self._result(job, work.model, self._answer(work.model, job), waiting)

    def _brief(self, name: str, texts: PolicyTexts) -> PolicyBrief:
        try:
            return self._brief_of(name, texts)
        except Refused:
            return PolicyBrief(name)

    def _result(
        self, job: Job, label: str, sheet: ScoreSheet, waiting: dict[str, Future[ScoreSheet | None]]
    ) -> ScoreResult:
        scores = list(_scores(job, label, sheet, shadow=False))
        usage = {label: sheet.usage}
        for shadow, future in waiting.items():
            watched = future.result()
            if watched is not None:
                scores.extend(_scores(job, shadow, watched, shadow=True))
                usage[shadow] = watched.usage
        return ScoreResult(scores=tuple(scores), usage=usage)

    def _answer(self, label: str, job: Job) -> ScoreSheet:
        """Return a sheet without gaps: what the model gave no score, the embedded scorer scores."""
        sheet = self._ask(label, job)
        gaps = [place for place, score in enumerate(sheet.scores) if score.fault]
        if not gaps:
            return sheet
        stand_in = self._ask(EMBEDDED, job._replace(test_cases=tuple(job.test_cases[place] for place in gaps)))
        scores = list(sheet.scores)
        for place, score in zip(gaps, stand_in.scores, strict=True):
            value = MIDDLE if score.fault else score.value
            scores[place] = score._replace(
                value=value, fault=scores[place].fault, scored_by=score.scored_by or EMBEDDED
            )
        return sheet._replace(scores=tuple(scores))

    def _waits(self, label: str) -> bool:
        try:
            return waits_for_a_server(self._model(label))
        except FarmError:
            return False

    def _cascade(self, job: Job, label: str, shadows: tuple[str, ...]) -> ScoreResult:
        """Let the model re-rank what it answers in time; the screen decides the rest, and watches what it did not."""
        assert job.within_s is not None, "a cascade needs to know how much time there is"
        screen = self._ask(EMBEDDED, job)
        places = first_by(screen.scores, self._paces.fitting(label, job.within_s, len(job.test_cases)))
        hurried = job._replace(deadline_s=min(job.deadline_s, job.within_s))
        with ThreadPoolExecutor(1 + len(shadows), thread_name_prefix="shadow") as threads:
            waiting = {one: threads.submit(self._watch, one, hurried) for one in shadows if one != EMBEDDED}
            sheet = screen._replace(scores=()) if not places else self._re_rank(label, hurried, places)
        answers = dict(zip(places, sheet.scores, strict=True))
        deciding = sheet._replace(scores=decided(screen.scores, answers, EMBEDDED))
        result = self._result(job, label, deciding, waiting)
        watched = ScoreSheet(tuple(screen.scores), screen.usage, screen.digest)
        beside = tuple(_scores(job, EMBEDDED, watched, shadow=True))
        return msgspec.structs.replace(result, scores=(*result.scores, *beside))

    def _re_rank(self, label: str, job: Job, places: list[int]) -> ScoreSheet:
        part = job._replace(test_cases=tuple(job.test_cases[place] for place in places))
        began_s = self._clock.monotonic_s()
        sheet = self._ask(label, part)
        answered = sum(1 for score in sheet.scores if not score.fault)
        self._paces.took(label, len(places), answered, self._clock.monotonic_s() - began_s)
        return sheet

    def _watch(self, label: str, job: Job) -> ScoreSheet | None:
        """Return the sheet of a model that only watches, None if it scored nothing."""
        sheet = self._ask(label, job)
        return None if all(score.fault for score in sheet.scores) else sheet

    def _ask(self, label: str, job: Job) -> ScoreSheet:
        started_s = self._clock.monotonic_s()
        try:
            model = self._model(label)
            with self._turn if model.parallel == 1 else nullcontext():
                sheet = model.score(job)
        except Raised as fault:  # the fault's name has no words of the exception's own: they may differ each time
            sheet = _all_faulty(job, told(fault.what, WORD_CHARS_MAX), str(fault))
        except Refused as fault:
            sheet = _all_faulty(job, "refused", str(fault))
        except Unavailable as fault:
            sheet = _all_faulty(job, "unreachable", str(fault))
        sheet = _checked(sheet, len(job.test_cases))
        faults = dict(Counter(score.fault for score in sheet.scores if score.fault))
        usage = msgspec.structs.replace(
            sheet.usage,
            latency_s=sheet.usage.latency_s or self._clock.monotonic_s() - started_s,
            faults=sheet.usage.faults or faults,
        )
        return sheet._replace(usage=usage)


def _all_faulty(job: Job, fault: str, message: str) -> ScoreSheet:
    return ScoreSheet(tuple(ModelScore(math.nan, message, fault) for _ in job.test_cases))


def _checked(sheet: ScoreSheet, count: int) -> ScoreSheet:
    """Name the faults of a model that gives too few scores or scores outside 0..10 instead of passing them on."""
    if len(sheet.scores) != count:
        return sheet._replace(scores=tuple(ModelScore(math.nan, fault="wrong-count") for _ in range(count)))
    scores = tuple(
        score if score.fault or SCORE_MIN <= score.value <= SCORE_MAX else score._replace(fault="out-of-range")
        for score in sheet.scores
    )
    return sheet._replace(scores=scores)


def _scores(job: Job, label: str, sheet: ScoreSheet, *, shadow: bool) -> list[Score]:
    return [
        Score(
            test_case=identity(case),
            value=score.value,
            model=label,
            scored_by=score.scored_by or label,
            model_digest=told(sheet.digest, WORD_CHARS_MAX),
            prompt_digest=told(score.prompt_digest, WORD_CHARS_MAX),
            reason=told(score.reason),
            fault=told(score.fault, WORD_CHARS_MAX),
            kind=told(score.kind, WORD_CHARS_MAX),
            shadow=shadow,
        )
        for case, score in zip(job.test_cases, sheet.scores, strict=True)
        if not (shadow and score.fault)
    ]


def open_service(brief_of: BriefOf, clock: Clock, transcript_file: Path | None = None) -> ScorerPool:
    """Return a replica of the pool.

    Args:
        brief_of: gives the words of a policy by name.
        clock: for latencies, deadlines and rests.
        transcript_file: where questions to language models and their answers are kept, nowhere if left out.
    """
    return ScorerPool(brief_of, clock, TranscriptFile(transcript_file) if transcript_file else silent)
