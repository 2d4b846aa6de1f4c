"""A slow model is asked only for what it answers while simulators have work; the screen decides the rest."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saflite.contract.errors import Refused
from saflite.contract.score import EMBEDDED
from saflite.contract.test_case import identity
from saflite.contract.work import ScoreResult
from saflite.scorer_pool import registry
from saflite.scorer_pool.cascade import Paces, decided, first_by
from saflite.scorer_pool.model import Job, ModelScore, PolicyBrief, ScoreSheet, Tools
from saflite.scorer_pool.work import ScorerPool, open_service

from .test_pool import cases, never, work

CASE_S = 2.0


class Clock:
    """Stands still until it is moved."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return self.now_s


class Slow:
    """A server that takes two seconds for a test case, one after the other, and gives up at the deadline."""

    label, parallel, waits = "slow", 2, True

    def __init__(self, clock: Clock) -> None:
        self.clock, self.asked = clock, list[int]()

    def score(self, job: Job) -> ScoreSheet:
        self.asked.append(len(job.test_cases))
        fits = min(len(job.test_cases), int(job.deadline_s / CASE_S))
        self.clock.now_s += min(job.deadline_s, CASE_S * len(job.test_cases))
        late = [ModelScore(math.nan, fault="deadline")] * (len(job.test_cases) - fits)
        return ScoreSheet((*[ModelScore(9.0, "slow")] * fits, *late))

    def warm(self, cancelled: object) -> str:
        return ""

    def close(self) -> None:
        pass


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def slow(clock: Clock) -> Slow:
    return Slow(clock)


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch, clock: Clock, slow: Slow) -> ScorerPool:
    real = registry.make

    def make(label: str, tools: Tools) -> object:
        if label == "gone":
            raise Refused("scorer", expected="one there is", got="gone")
        return slow if label == "slow" else real(label, tools)

    monkeypatch.setattr("saflite.scorer_pool.work.make", make)
    return open_service(lambda name, texts: PolicyBrief(name, "words"), clock)


def scored(pool: ScorerPool, within_s: float | None, model: str = "slow", count: int = 8) -> ScoreResult:
    result = pool.do(work(model, count=count, within_s=within_s), never)
    assert isinstance(result, ScoreResult)
    deciding = [score for score in result.scores if not score.shadow]
    assert [score.test_case for score in deciding] == [identity(case) for case in cases(count)]
    return result


def by_model(result: ScoreResult) -> int:
    return sum(1 for score in result.scores if not score.shadow and score.scored_by == score.model)


def test_without_a_limit_the_model_scores_everything(pool: ScorerPool) -> None:
    assert by_model(scored(pool, None)) == 8


def test_while_nothing_flies_the_screen_decides_alone(pool: ScorerPool, slow: Slow, clock: Clock) -> None:
    result = scored(pool, 0.0)
    assert (by_model(result), slow.asked, clock.now_s) == (0, [], 0.0)
    assert {(score.scored_by, score.fault) for score in result.scores} == {(EMBEDDED, "")}


def test_the_time_it_takes_is_learnt_and_kept_to(pool: ScorerPool, slow: Slow, clock: Clock) -> None:
    for _ in range(6):
        before_s = clock.now_s
        result = scored(pool, 7.0)
        assert clock.now_s - before_s <= 7.0
        assert by_model(result) == 3
    assert slow.asked[-1] == 3


def test_it_is_asked_for_what_the_screen_puts_first(pool: ScorerPool) -> None:
    for _ in range(6):
        result = scored(pool, 7.0)
    seen = {score.test_case: score.value for score in result.scores if score.shadow}
    asked = {score.test_case for score in result.scores if not score.shadow and score.scored_by == "slow"}
    rest = set(seen) - asked
    assert len(seen) == 8
    assert min(seen[name] for name in asked) >= max(seen[name] for name in rest)


def test_a_server_far_too_slow_costs_no_more_than_the_time_there_is(pool: ScorerPool, clock: Clock) -> None:
    for _ in range(20):
        before_s = clock.now_s
        scored(pool, 0.5)
        assert clock.now_s - before_s <= 0.5
    assert clock.now_s < 20 * 0.5 / 2, "it is asked again and again although it never answers in time"


def test_embedded_models_and_missing_ones_are_no_matter_of_time(pool: ScorerPool) -> None:
    assert by_model(scored(pool, 0.0, model="gap")) == 8
    result = scored(pool, 0.0, model="gone")
    assert all("refused" in score.fault for score in result.scores if not score.shadow)


def test_a_fault_of_the_server_is_told_and_our_impatience_is_none() -> None:
    screen = [ModelScore(1.0), ModelScore(2.0), ModelScore(3.0)]
    late, broken = ModelScore(math.nan, fault="deadline"), ModelScore(math.nan, fault="schema")
    found = decided(screen, {0: late, 1: broken}, EMBEDDED)
    assert [(score.value, score.fault, score.scored_by) for score in found] == [
        (1.0, "", EMBEDDED),
        (2.0, "schema", EMBEDDED),
        (3.0, "", EMBEDDED),
    ]


@given(st.lists(st.floats(0, 10), max_size=12), st.integers(0, 12))
def test_the_first_by_the_screen(values: list[float], many: int) -> None:
    places = first_by([ModelScore(value) for value in values], many)
    assert len(places) == min(many, len(values))
    assert places == sorted(set(places))


def test_a_server_that_was_slow_is_tried_again_in_the_end() -> None:
    paces = Paces()
    paces.took("slow", 4, 0, 10.0)
    assert any(paces.fitting("slow", 1.0, 4) for _ in range(50))
