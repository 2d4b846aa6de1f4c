"""Scores with a language model behind a chat server: cached, sized, asked again once, guarded by a circuit breaker.

Whatever the server does, every test case gets a score or a named fault in time: `deadline`, `loading`, `busy`,
`unreachable`, `refused`, `circuit-open`, or a fault of `parse.py`. The pool fills faults with the embedded scorer.
"""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field

from saflite.contract.bounds import told
from saflite.contract.clock import Clock
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.score import Usage
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase, identity
from saflite.scorer_pool.llm.allowance import Allowance
from saflite.scorer_pool.llm.background import Background
from saflite.scorer_pool.llm.batch_size import BatchSizer
from saflite.scorer_pool.llm.cache import Cache, key_of
from saflite.scorer_pool.llm.chat import Busy, Chat, ChatResult, Question
from saflite.scorer_pool.llm.circuit_breaker import Breaker
from saflite.scorer_pool.llm.parse import Reply, parse
from saflite.scorer_pool.llm.prompt import WORDS_CHARS_MAX, Prompt, again, answer_schema, build
from saflite.scorer_pool.llm.transcript import Exchange, Transcript, silent
from saflite.scorer_pool.model import Job, ModelScore, ScoreSheet

CONTEXT_TOKENS = 8192
"""Room for question and answer. Servers cut longer questions off at the beginning and say nothing, so none is asked."""

CHARS_PER_TOKEN = 2.2  # of texts full of numbers
TOKENS_BESIDES = 120
TOKENS_PER_SCORE = 50  # its id twice, its score
TOKENS_PER_CASE = TOKENS_PER_SCORE + math.ceil(2 * WORDS_CHARS_MAX / CHARS_PER_TOKEN)  # and two sentences
BACK_OFF_FIRST_S, BACK_OFF_MAX_S = 0.25, 4.0
PROBES = (1, 2, 4)
LOADING_WAIT_S = 8.0
"""How long a batch waits for a model that is being loaded; the embedded scorer does not let simulators wait longer."""


class Prices:
    """Dollars per million tokens in and out; 0 where none is set."""

    def __init__(self, per_million_in: float = 0.0, per_million_out: float = 0.0) -> None:
        self._in, self._out = per_million_in, per_million_out

    def cost_usd(self, tokens_in: int, tokens_out: int) -> float:
        """Return what the tokens cost."""
        return (tokens_in * self._in + tokens_out * self._out) / 1e6


@dataclass
class _Count:
    """What one job took."""

    tokens_in: int = 0
    tokens_out: int = 0
    calls: int = 0
    asked_again: int = 0
    cached: int = 0
    faults: Counter[str] = field(default_factory=Counter)

    def add(self, other: _Count) -> None:
        """Add what another job took."""
        self.tokens_in += other.tokens_in
        self.tokens_out += other.tokens_out
        self.calls += other.calls
        self.asked_again += other.asked_again
        self.faults += other.faults


class LanguageModel:
    """A scorer model on a chat server."""

    waits = True

    def __init__(
        self,
        label: str,
        chat: Chat,
        clock: Clock,
        load_deadline_s: float,
        prices: Prices | None = None,
        transcript: Transcript = silent,
        *,
        brief: bool = False,
    ) -> None:
        self.label = label
        self._brief = brief
        self._chat = chat
        self._clock = clock
        self._load_deadline_s = load_deadline_s
        self._prices = prices or Prices()
        self._transcript = transcript
        self._background = Background(label)
        self._breaker = Breaker(clock)
        self._cache = Cache()
        self._batch_sizer = BatchSizer()
        self._allowance = Allowance()
        self._digest = ""
        self._loading: Future[str] | None = None
        self._ready = False
        self._turns: tuple[int, asyncio.Semaphore] | None = None
        self._trial: asyncio.Task[None] | None = None
        self._tried: list[_Count] = []

    @property
    def parallel(self) -> int:
        """One batch more than the server answers side by side, so that it never waits for the next."""
        return self._batch_sizer.side_by_side + 1

    # ---- warming -----------------------------------------------------------------------------------------------

    def warm(self, cancelled: Cancelled) -> str:
        """Load the model, ask one probe, find out how many questions are worth putting side by side.

        Raises:
            Unavailable, Refused: it cannot be reached, loaded in time, or does not answer.
        """
        try:
            message = self._background.run(self._warm(), cancelled)
        except CancelledError as fault:
            raise Unavailable(f"{self.label}: warming was cancelled") from fault
        self._breaker.succeeded()
        return message

    async def _warm(self) -> str:
        """Load under the load deadline, then find out how many questions are worth putting side by side."""
        try:
            async with asyncio.timeout(self._load_deadline_s):
                about = await self._chat.load()
                self._digest = told(await self._chat.digest())
                seconds = {count: await self._probe(count) for count in PROBES}
                seconds[1] = min(seconds[1], await self._probe(1))  # the first may have waited for another's question
        except TimeoutError as fault:
            raise Unavailable(f"{self.label}: not loaded within {self._load_deadline_s:g} s") from fault
        self._batch_sizer.probed(seconds)
        self._ready = True
        return f"{about}; {self._batch_sizer.side_by_side} questions side by side"

    async def _probe(self, count: int) -> float:
        started_s = self._clock.monotonic_s()
        await asyncio.gather(*(self._chat.ask(_probe_question()) for _ in range(count)))
        return self._clock.monotonic_s() - started_s

    def close(self) -> None:
        """Stop waiting for anything."""
        self._background.close()

    def answer(self, question: Question, deadline_s: float, cancelled: Cancelled) -> tuple[Reply | None, str]:
        """Return the reply to a question of any kind, or None and the name of the fault."""
        try:
            return self._background.run(self._answer(question, deadline_s), cancelled), ""
        except TimeoutError:
            return None, "deadline"
        except CancelledError:
            return None, "cancelled"
        except Refused as fault:
            return None, f"refused: {fault}"
        except Unavailable as fault:
            return None, f"unreachable: {fault}"

    async def _answer(self, question: Question, deadline_s: float) -> Reply:
        async with asyncio.timeout(deadline_s):
            result = await self._patiently(question, _Count())
            if result.cut:
                result = await self._patiently(question, _Count())
            return result.reply

    # ---- scoring -----------------------------------------------------------------------------------------------

    def score(self, job: Job) -> ScoreSheet:
        """Return a score or a named fault per test case, within the job's deadline; never raises for the server."""
        count = _Count()
        try:
            scores = self._background.run(self._score(job, count), job.cancelled)
        except CancelledError:
            scores = [_fault("cancelled") for _ in job.test_cases]
        count.faults.update(score.fault for score in scores if score.fault)
        usage = Usage(
            tokens_in=count.tokens_in,
            tokens_out=count.tokens_out,
            cost_usd=self._prices.cost_usd(count.tokens_in, count.tokens_out),
            calls=count.calls,
            asked_again=count.asked_again,
            cached=count.cached,
            faults=dict(count.faults),
        )
        return ScoreSheet(tuple(scores), usage, self._digest)

    async def _score(self, job: Job, count: _Count) -> list[ModelScore]:
        ends_s = self._clock.monotonic_s() + job.deadline_s
        found = self._from_cache(job, count)
        missing = {identity(case): case for case in job.test_cases if identity(case) not in found}
        if missing:
            found |= await self._asked(tuple(missing.values()), job, ends_s, count)
        self._keep(missing.values(), job, found)
        return [found[identity(case)] for case in job.test_cases]

    def _from_cache(self, job: Job, count: _Count) -> dict[str, ModelScore]:
        if not self._digest:
            return {}
        kept = {identity(case): self._cache.get(key_of(case, job.briefs, self._digest)) for case in job.test_cases}
        found = {name: score for name, score in kept.items() if score is not None}
        count.cached = len(found)
        return found

    def _keep(self, cases: Iterable[TestCase], job: Job, found: Mapping[str, ModelScore]) -> None:
        for case in cases:
            self._cache.put(key_of(case, job.briefs, self._digest), found[identity(case)])

    async def _asked(
        self, cases: tuple[TestCase, ...], job: Job, ends_s: float, count: _Count
    ) -> dict[str, ModelScore]:
        """Ask unless the breaker is open. The question it is tried with keeps no batch waiting."""
        while self._tried:
            count.add(self._tried.pop())
        if not self._breaker.is_open:
            return await self._told(cases, job, ends_s, count)
        if self._breaker.passes():
            self._trial = asyncio.create_task(self._try(cases, job))
        return {identity(case): _fault("circuit-open") for case in cases}

    async def _try(self, cases: tuple[TestCase, ...], job: Job) -> None:
        count, ends_s = _Count(), self._clock.monotonic_s() + job.deadline_s
        self._keep(cases, job, await self._told(cases, job, ends_s, count))
        self._tried.append(count)

    async def _told(self, cases: tuple[TestCase, ...], job: Job, ends_s: float, count: _Count) -> dict[str, ModelScore]:
        """Ask and let the breaker know how it went."""
        try:
            found = await self._parts(cases, job, ends_s, count)
        except asyncio.CancelledError:
            self._breaker.abandoned()
            raise
        if all(score.fault for score in found.values()):
            self._breaker.failed()
        else:
            self._breaker.succeeded()
        return found

    async def _parts(
        self, cases: tuple[TestCase, ...], job: Job, ends_s: float, count: _Count
    ) -> dict[str, ModelScore]:
        fault = await self._loaded(ends_s)
        if fault:
            return {identity(case): _fault(fault) for case in cases}
        size = self._batch_sizer.per_question(job.deadline_s)
        parts = self._split(cases, size, job)
        found: dict[str, ModelScore] = {}
        for part in await asyncio.gather(*(self._part(part, job, ends_s, count) for part in parts)):
            found |= part
        return found

    async def _loaded(self, ends_s: float) -> str:
        """Return a fault unless the model is loaded in time; loading goes on when this question's time is over."""
        try:
            if self._ready and (self._loading is None or self._loading.done()):
                return ""
            if self._loading is None or (self._loading.done() and not self._ready):
                self._loading = self._background.start(self._warm())
            loading = asyncio.wrap_future(self._loading)
            loading.add_done_callback(_seen)  # it may fail when nobody waits for it any more
            await asyncio.wait([loading], timeout=min(LOADING_WAIT_S, self._left(ends_s)))
            if not loading.done():
                return "loading"
            loading.result()
        except Refused:
            return "refused"
        except Unavailable:
            return "unreachable"
        return ""

    async def _part(self, cases: tuple[TestCase, ...], job: Job, ends_s: float, count: _Count) -> dict[str, ModelScore]:
        """Ask about some test cases; what was answered before a fault is kept."""
        found: dict[str, ModelScore] = {}
        fault, message = "", ""
        try:
            async with asyncio.timeout(self._left(ends_s)), self._turn():
                await self._twice(cases, job, count, found)
        except TimeoutError:
            fault = "deadline"
            self._batch_sizer.missed(len(cases))
        except Busy:
            fault = "busy"
        except Refused as refused:
            fault, message = "refused", str(refused)
        except Unavailable as unavailable:
            fault, message = "unreachable", str(unavailable)
            self._ready = False
        return {identity(case): found.get(identity(case), _fault(fault, message)) for case in cases}

    def _turn(self) -> asyncio.Semaphore:
        """Return the turns of all jobs of this model: as many questions at a time as the server answers at a time."""
        if self._turns is None or self._turns[0] != self._batch_sizer.side_by_side:
            self._turns = (self._batch_sizer.side_by_side, asyncio.Semaphore(self._batch_sizer.side_by_side))
        return self._turns[1]

    async def _twice(self, cases: tuple[TestCase, ...], job: Job, count: _Count, found: dict[str, ModelScore]) -> None:
        """Ask, and once more about those test cases whose answer could not be used."""
        prompt = self._prompt(cases, job)
        found |= await self._once(cases, prompt, prompt.messages, count)
        faulty = tuple(case for case in cases if found[identity(case)].fault)
        if not faulty:
            return
        count.asked_again += 1
        named = ", ".join(sorted({found[identity(case)].fault for case in faulty}))
        count.faults.update(f"first:{found[identity(case)].fault}" for case in faulty)
        second = self._prompt(faulty, job)
        found |= await self._once(faulty, second, again(second, named), count)

    async def _once(
        self, cases: tuple[TestCase, ...], prompt: Prompt, messages: list[dict[str, str]], count: _Count
    ) -> dict[str, ModelScore]:
        started_s = self._clock.monotonic_s()
        schema = answer_schema(prompt.keys, brief=prompt.brief)
        result = await self._patiently(Question(messages, schema, _answer_tokens(prompt)), count)
        self._batch_sizer.answered(len(cases), self._clock.monotonic_s() - started_s)
        self._transcript(Exchange(self.label, prompt.digest, messages, result.reply.content, result.reply.thinking))
        count.tokens_in += result.tokens_in
        count.tokens_out += result.tokens_out
        parsed = parse(result.reply, prompt.keys)
        scores: dict[str, ModelScore] = {}
        for case, key in zip(cases, prompt.keys, strict=True):
            if key in parsed.lines:
                line = parsed.lines[key]
                scores[identity(case)] = ModelScore(line.ranked, line.reason, prompt_digest=prompt.digest)
            else:
                scores[identity(case)] = _fault("truncated" if result.cut else parsed.faults[key])
        return scores

    async def _patiently(self, question: Question, count: _Count) -> ChatResult:
        """Ask, and again after a growing pause while the server is busy; the caller's deadline ends it."""
        pause_s = BACK_OFF_FIRST_S
        while True:
            count.calls += 1
            try:
                result = await self._chat.ask(question._replace(tokens_max=question.tokens_max + self._allowance.more))
            except Busy:
                count.faults["first:busy"] += 1
                await asyncio.sleep(pause_s)
                pause_s = min(BACK_OFF_MAX_S, 2.0 * pause_s)
                continue
            if result.cut:
                self._allowance.was_cut(question.tokens_max)
            return result

    # ---- what fits -----------------------------------------------------------------------------------------------

    def _fits(self, prompt: Prompt) -> bool:
        answer = _answer_tokens(prompt) + self._allowance.more
        return len(prompt.system) + len(prompt.user) <= CHARS_PER_TOKEN * (CONTEXT_TOKENS - answer)

    def _prompt(self, cases: tuple[TestCase, ...], job: Job) -> Prompt:
        """Return the question, without earlier flights where they would make it too long."""
        prompt = build(cases, job.briefs, job.history, brief=self._brief)
        return prompt if self._fits(prompt) else build(cases, job.briefs, brief=self._brief)

    def _split(self, cases: tuple[TestCase, ...], size: int, job: Job) -> list[tuple[TestCase, ...]]:
        """Return the test cases in parts of at most `size`, smaller where a question would not fit the context."""
        parts: list[tuple[TestCase, ...]] = []
        for start in range(0, len(cases), size):
            part = cases[start : start + size]
            if len(part) > 1 and not self._fits(build(part, job.briefs, job.history, brief=self._brief)):
                parts += self._split(part, (len(part) + 1) // 2, job)
            else:
                parts.append(part)
        return parts

    def _left(self, ends_s: float) -> float:
        return max(0.0, ends_s - self._clock.monotonic_s())


def _answer_tokens(prompt: Prompt) -> int:
    return TOKENS_BESIDES + (TOKENS_PER_SCORE if prompt.brief else TOKENS_PER_CASE) * len(prompt.keys)


def _seen(future: asyncio.Future[str]) -> None:
    """Look at what became of a future, so that the loop does not complain that nobody did."""
    if not future.cancelled():
        future.exception()


def _fault(name: str, message: str = "") -> ModelScore:
    return ModelScore(math.nan, message, name)


def _probe_question() -> Question:
    schema = {"type": "object", "properties": {"ready": {"type": "boolean"}}, "required": ["ready"]}
    return Question([{"role": "user", "content": 'Answer {"ready": true}'}], schema, 16)
