"""The pool: one deciding score per test case whatever a model does, shadows aside, outcomes told once."""

from __future__ import annotations

import math
from typing import Any

import pytest

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase, identity
from saflite.contract.work import HandedBack, Outcome, ScoreResult, ScoreWork, WarmResult, WarmWork
from saflite.flight.mission import builtin_mission
from saflite.scorer_pool import registry
from saflite.scorer_pool.model import Job, ModelScore, PolicyBrief, ScoreSheet, Tools
from saflite.scorer_pool.work import ScorerPool, open_service


class StillClock:
    def monotonic_s(self) -> float:
        return 0.0

    def unix_s(self) -> float:
        return 0.0


class Odd:
    """A model that misbehaves as its argument says."""

    parallel = 3

    def __init__(self, argument: str, tools: Tools) -> None:
        self.label = f"odd:{argument}"
        self.argument = argument

    def score(self, job: Job) -> ScoreSheet:
        good = [ModelScore(float(place), "odd") for place in range(len(job.test_cases))]
        if self.argument == "dead":
            raise Unavailable("no such server")
        if self.argument == "short":
            return ScoreSheet(tuple(good[:-1]))
        if self.argument == "nan":
            return ScoreSheet((ModelScore(math.nan), *good[1:]))
        if self.argument == "eleven":
            return ScoreSheet((*good[:-1], ModelScore(11.0)))
        if self.argument == "gap":
            return ScoreSheet((good[0], ModelScore(math.nan, fault="schema"), *good[2:]))
        return ScoreSheet(tuple(good))

    def warm(self, cancelled: object) -> str:
        if self.argument == "dead":
            raise Unavailable("no such server")
        return "ready"

    def close(self) -> None:
        pass


def cases(count: int) -> tuple[TestCase, ...]:
    mission = builtin_mission("mission2")
    return tuple(
        TestCase(
            target=Target(),
            scenario=Scenario(
                mission=mission,
                obstacles=(Obstacle(length_m=5, width_m=5, height_m=20, x_m=float(place), y_m=20.0),),
            ),
        )
        for place in range(count)
    )


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> ScorerPool:
    real = registry.make
    monkeypatch.setattr(
        "saflite.scorer_pool.work.make",
        lambda label, tools: Odd(label[4:], tools) if label.startswith("odd:") else real(label, tools),
    )
    return open_service(lambda name, texts: PolicyBrief(name, "words"), StillClock())


def work(model: str, shadow: tuple[str, ...] = (), count: int = 4, **more: Any) -> ScoreWork:
    return ScoreWork(round=0, model=model, shadow=shadow, policies=("p",), test_cases=cases(count), rng_seed=1, **more)


def never() -> bool:
    return False


def test_every_test_case_gets_its_own_score_labelled_with_its_model(pool: ScorerPool) -> None:
    result = pool.do(work("odd:good"), never)
    assert isinstance(result, ScoreResult)
    assert [score.test_case for score in result.scores] == [identity(case) for case in cases(4)]
    assert [score.value for score in result.scores] == [0.0, 1.0, 2.0, 3.0]
    assert {(score.model, score.scored_by, score.fault, score.shadow) for score in result.scores} == {
        ("odd:good", "odd:good", "", False)
    }


@pytest.mark.parametrize(
    ("label", "faulty", "fault"),
    [
        ("odd:dead", {0, 1, 2, 3}, "unreachable"),
        ("odd:short", {0, 1, 2, 3}, "wrong-count"),
        ("odd:nan", {0}, "out-of-range"),
        ("odd:eleven", {3}, "out-of-range"),
        ("odd:gap", {1}, "schema"),
        ("no-such-model", {0, 1, 2, 3}, "refused"),
    ],
)
def test_embedded_scorer_steps_in_where_a_model_fails(
    pool: ScorerPool, label: str, faulty: set[int], fault: str
) -> None:
    result = pool.do(work(label), never)
    embedded = pool.do(work("blend"), never)
    assert isinstance(result, ScoreResult)
    assert isinstance(embedded, ScoreResult)
    for place, (score, other) in enumerate(zip(result.scores, embedded.scores, strict=True)):
        assert score.model == label
        if place in faulty:
            assert (score.scored_by, score.fault, score.value) == ("blend", fault, other.value)
        else:
            assert (score.scored_by, score.fault, score.value) == (label, "", float(place))
    assert result.usage[label].faults == {fault: len(faulty)}


def test_shadows_watch_and_never_decide(pool: ScorerPool) -> None:
    result = pool.do(work("odd:good", shadow=("constant:7", "odd:dead", "odd:good")), never)
    assert isinstance(result, ScoreResult)
    deciding = [score for score in result.scores if not score.shadow]
    watching = [score for score in result.scores if score.shadow]
    assert [score.model for score in deciding] == ["odd:good"] * 4
    assert [(score.model, score.value) for score in watching] == [("constant:7", 7.0)] * 4


def test_warming_says_whether_a_model_answers(pool: ScorerPool) -> None:
    assert pool.do(WarmWork(model="odd:good"), never) == WarmResult(model="odd:good", ready=True, message="ready")
    dead = pool.do(WarmWork(model="odd:dead"), never)
    assert isinstance(dead, WarmResult)
    assert not dead.ready
    assert "no such server" in dead.message
    unknown = pool.do(WarmWork(model="gpt5"), never)
    assert isinstance(unknown, WarmResult)
    assert not unknown.ready
    assert "expected one of" in unknown.message


def test_outcomes_are_told_once_and_gaps_are_noticed(pool: ScorerPool) -> None:
    told = tuple(
        Outcome(test_case=case, round=place, ending="completed", robustness=1.0) for place, case in enumerate(cases(4))
    )
    assert pool.cursor == -1
    pool.do(work("novelty", recent=told[:2], from_cursor=-1, cursor=1), never)
    assert pool.cursor == 1
    again = pool.do(work("novelty", recent=told, from_cursor=-1, cursor=3), never)
    assert pool.cursor == 3
    old = pool.do(work("novelty", recent=(), from_cursor=3, cursor=1), never)
    first = pool.do(work("novelty", recent=told[:2], from_cursor=-1, cursor=1), never)
    assert old == first != again
    with pytest.raises(Unavailable):
        pool.do(work("novelty", recent=(), from_cursor=5, cursor=6), never)


def test_cancelled_work_is_handed_back(pool: ScorerPool) -> None:
    assert isinstance(pool.do(work("blend"), lambda: True), HandedBack)


def test_more_leases_at_once_only_for_models_that_wait(pool: ScorerPool) -> None:
    pool.do(work("blend"), never)
    assert pool.parallel == 1
    pool.do(work("odd:good"), never)
    assert pool.parallel == 3


@pytest.mark.parametrize(
    "label",
    [
        *("nonsense", "constant:11", "ollama:", "openai:x@nourl", "ensemble:ensemble", "ensemble:nonsense", "gap:1"),
        *("ollama:m@h:99999", "ollama:m@h:x", "ollama:m@[", "ollama:m@\0", "ensemble:ollama:m@["),
    ],
)
def test_labels_no_model_can_be_made_of_are_refused_before_anything_starts(label: str) -> None:
    with pytest.raises(Refused):
        registry.check_label(label)


@pytest.mark.parametrize("label", ["blend", "constant:7", "ollama:m:7b@h:1", "openai:x@http://h/v1", "ensemble:gap"])
def test_labels_of_models_need_no_server_to_be_checked(label: str) -> None:
    registry.check_label(label)
