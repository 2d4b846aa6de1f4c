"""Scoring with a language model that answers, babbles, hangs, is busy, or dies: a score or a named fault in time."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase
from saflite.flight.mission import builtin_mission
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.llm import scorer as llm_scorer
from saflite.scorer_pool.llm import transcript
from saflite.scorer_pool.llm.case_text import keys
from saflite.scorer_pool.llm.chat import Busy, ChatResult, Question
from saflite.scorer_pool.llm.circuit_breaker import FAILURES_MAX, REST_FIRST_S, REST_MAX_S, Breaker
from saflite.scorer_pool.llm.parse import Reply
from saflite.scorer_pool.llm.scorer import LanguageModel, Prices
from saflite.scorer_pool.llm.transcript import Exchange, TranscriptFile
from saflite.scorer_pool.model import Job, PolicyBrief, ScoreSheet

BRIEFS = (PolicyBrief("p", "keep away"),)


def cases(count: int, start: int = 0) -> tuple[TestCase, ...]:
    mission = builtin_mission("mission2")
    return tuple(
        TestCase(
            target=Target(),
            scenario=Scenario(
                mission=mission,
                obstacles=(Obstacle(length_m=5, width_m=5, height_m=20, x_m=float(place), y_m=20.0),),
            ),
        )
        for place in range(start, start + count)
    )


def asked_keys(question: Question) -> list[str]:
    found: list[str] = question.schema["properties"]["ranking"]["items"]["enum"]
    return found


def good(question: Question, **wrong: Any) -> ChatResult:
    rows = {
        key: {"interpretation": "i", "effect": "e", "score": int(key[1], 16) % 11, **wrong}
        for key in asked_keys(question)
    }
    return ChatResult(Reply(json.dumps({"test_cases": rows})), tokens_in=100, tokens_out=10)


Answerer = Callable[[Question], ChatResult]


class ScriptedChat:
    """Answers each question with the next line of its script; the last line is repeated."""

    def __init__(self, *script: Answerer | BaseException | None) -> None:
        self.script = list(script)
        self.asked: list[Question] = []
        self.loads = 0
        self.load_fault: BaseException | None = None
        self.load_wait: asyncio.Event | None = None

    async def ask(self, question: Question) -> ChatResult:
        if "ready" in question.schema["properties"]:
            return ChatResult(Reply('{"ready": true}'))
        self.asked.append(question)
        line = self.script.pop(0) if len(self.script) > 1 else self.script[0]
        if line is None:
            await asyncio.Event().wait()
        if isinstance(line, BaseException):
            raise line
        assert line is not None
        return line(question)

    async def load(self) -> str:
        self.loads += 1
        if self.load_wait:
            await self.load_wait.wait()
        if self.load_fault:
            raise self.load_fault
        return "loaded"

    async def digest(self) -> str:
        return "d1"


def model(*script: Answerer | BaseException | None) -> tuple[LanguageModel, ScriptedChat]:
    chat = ScriptedChat(*script)
    return LanguageModel("fake:m", chat, WallClock(), 5.0, Prices(1.0, 2.0)), chat


def job(count: int = 3, deadline_s: float = 5.0, start: int = 0) -> Job:
    return Job(cases(count, start), BRIEFS, deadline_s=deadline_s)


def test_good_answer_is_paired_by_id_and_counted() -> None:
    scorer, _ = model(good)
    sheet = scorer.score(job())
    assert [score.value for score in sheet.scores] == [int(key[1], 16) % 11 for key in keys(cases(3))]
    assert all(score.reason == "i e" and score.prompt_digest for score in sheet.scores)
    assert (sheet.usage.calls, sheet.usage.tokens_in, sheet.usage.tokens_out, sheet.digest) == (1, 100, 10, "d1")
    assert sheet.usage.cost_usd == pytest.approx(120e-6)
    scorer.close()


def test_brief_scores_are_asked_for_in_fewer_tokens_and_read_without_words() -> None:
    def scores_alone(question: Question) -> ChatResult:
        document = {"test_cases": {key: {"score": 7} for key in asked_keys(question)}}
        jsonschema.validate({**document, "ranking": asked_keys(question)}, question.schema)
        return ChatResult(Reply(json.dumps(document)))

    chat = ScriptedChat(scores_alone)
    brief = LanguageModel("fake:m+brief", chat, WallClock(), 5.0, brief=True)
    whole, worded = model(good)
    sheet = brief.score(job())
    whole.score(job())
    assert [(score.value, score.reason, score.fault) for score in sheet.scores] == [(7.0, "", "")] * 3
    asked, full = chat.asked[0], worded.asked[0]
    assert asked.tokens_max < full.tokens_max / 2
    assert "one sentence" in full.messages[0]["content"]
    assert "one sentence" not in asked.messages[0]["content"]
    assert asked.messages[1] == full.messages[1]
    brief.close()
    whole.close()


def test_equal_test_cases_in_one_batch_are_asked_about_once() -> None:
    scorer, chat = model(good)
    twice = cases(2) + cases(2)
    sheet = scorer.score(Job(twice, BRIEFS))
    assert len(asked_keys(chat.asked[0])) == 2
    assert sheet.scores[:2] == sheet.scores[2:]
    scorer.close()


def test_second_time_comes_from_the_cache_but_other_words_do_not() -> None:
    scorer, chat = model(good)
    first = scorer.score(job())
    second = scorer.score(job())
    assert first.scores == second.scores
    assert (len(chat.asked), second.usage.calls, second.usage.cached) == (1, 0, 3)
    scorer.score(job()._replace(briefs=(PolicyBrief("p", "something else"),)))
    assert len(chat.asked) == 2
    scorer.close()


def test_asks_again_once_with_the_fault_named_and_only_about_what_is_missing() -> None:
    def partly(question: Question) -> ChatResult:
        answer = json.loads(good(question).reply.content)
        answer["test_cases"][asked_keys(question)[1]]["score"] = 11
        return ChatResult(Reply(json.dumps(answer)))

    scorer, chat = model(partly, good)
    sheet = scorer.score(job())
    assert not any(score.fault for score in sheet.scores)
    assert asked_keys(chat.asked[1]) == [keys(cases(3))[1]]
    assert "out-of-range" in chat.asked[1].messages[-1]["content"]
    assert sheet.usage.asked_again == 1
    assert sheet.usage.faults == {"first:out-of-range": 1}
    scorer.close()


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        (lambda question: ChatResult(Reply("I cannot help")), "not-json"),
        (lambda question: good(question, id="c0"), "schema"),
        (lambda question: good(question, score="8/10"), "not-a-number"),
        (lambda question: ChatResult(Reply('{"test_cases": [{"id"'), cut=True), "truncated"),
        (Unavailable("gone"), "unreachable"),
        (Refused("model", expected="a", got="b"), "refused"),
    ],
)
def test_what_stays_unusable_is_a_named_fault(line: Any, fault: str) -> None:
    scorer, _ = model(line)
    sheet = scorer.score(job())
    assert [score.fault for score in sheet.scores] == [fault] * 3
    assert sheet.usage.faults[fault] == 3
    scorer.close()


def test_a_hung_server_costs_no_more_than_the_deadline_and_smaller_questions_follow() -> None:
    scorer, chat = model(None)
    clock = WallClock()
    started_s = clock.monotonic_s()
    sheet = scorer.score(job(8, deadline_s=0.1))
    assert [score.fault for score in sheet.scores] == ["deadline"] * 8
    assert clock.monotonic_s() - started_s < 2.0
    chat.script = [good]
    assert not any(score.fault for score in scorer.score(job(8)).scores)
    assert len(asked_keys(chat.asked[1])) == 4
    scorer.close()


def test_busy_server_is_asked_again_after_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llm_scorer, "BACK_OFF_FIRST_S", 0.001)
    scorer, _ = model(Busy("503"), Busy("503"), good)
    sheet = scorer.score(job())
    assert not any(score.fault for score in sheet.scores)
    assert sheet.usage.faults == {"first:busy": 2}
    assert sheet.usage.calls == 3
    scorer.close()


def test_dead_server_opens_the_circuit_and_is_left_alone() -> None:
    scorer, chat = model(Unavailable("gone"))
    for start in range(FAILURES_MAX):
        scorer.score(job(start=10 * start))
    asked = len(chat.asked)
    sheet = scorer.score(job(start=100))
    assert [score.fault for score in sheet.scores] == ["circuit-open"] * 3
    assert len(chat.asked) == asked
    scorer.close()


def test_model_that_cannot_be_loaded_is_a_fault_and_warming_says_why() -> None:
    scorer, chat = model(good)
    chat.load_fault = Unavailable("no such host")
    assert {score.fault for score in scorer.score(job()).scores} == {"unreachable"}
    with pytest.raises(Unavailable, match="no such host"):
        scorer.warm(lambda: False)
    chat.load_fault = None
    assert "loaded" in scorer.warm(lambda: False)
    assert not any(score.fault for score in scorer.score(job()).scores)
    scorer.close()


def test_a_server_that_came_back_is_loaded_again() -> None:
    scorer, chat = model(good, Unavailable("restarting"), good)
    scorer.score(job())
    assert {score.fault for score in scorer.score(job(start=10)).scores} == {"unreachable"}
    assert not any(score.fault for score in scorer.score(job(start=20)).scores)
    assert chat.loads == 2
    scorer.close()


def test_cancelled_score_returns_at_once() -> None:
    scorer, _ = model(None)
    sheet = scorer.score(job()._replace(cancelled=lambda: True, deadline_s=60.0))
    assert {score.fault for score in sheet.scores} == {"cancelled"}
    scorer.close()


class HandClock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return self.now_s


def test_breaker_opens_tries_once_rests_longer_and_closes() -> None:
    clock = HandClock()
    breaker = Breaker(clock)
    for _ in range(FAILURES_MAX):
        assert breaker.passes()
        breaker.failed()
    assert not breaker.passes()
    clock.now_s = REST_FIRST_S
    assert breaker.passes()
    assert not breaker.passes()  # one at a time
    breaker.failed()
    clock.now_s += REST_FIRST_S
    assert not breaker.passes()
    clock.now_s += REST_MAX_S
    assert breaker.passes()
    breaker.succeeded()
    assert breaker.passes()
    assert not breaker.is_open


def test_a_trial_taken_back_leaves_room_for_another() -> None:
    clock = HandClock()
    breaker = Breaker(clock)
    for _ in range(FAILURES_MAX):
        breaker.failed()
    clock.now_s = REST_FIRST_S
    assert breaker.passes()
    assert not breaker.passes()
    breaker.abandoned()
    assert breaker.passes()


def opened(*script: Answerer | BaseException | None) -> tuple[LanguageModel, ScriptedChat, HandClock]:
    """Return a model whose circuit was opened by failures and whose rest is over; `script` follows."""
    clock, chat = HandClock(), ScriptedChat(Unavailable("gone"))
    scorer = LanguageModel("fake:m", chat, clock, 5.0)
    for start in range(FAILURES_MAX):
        scorer.score(job(start=10 * start))
    clock.now_s += REST_MAX_S
    chat.script = list(script)
    return scorer, chat, clock


def once_well(scorer: LanguageModel, clock: HandClock, start: int) -> ScoreSheet:
    """Return the first sheet of a batch that is not kept from the server, rest after rest."""
    ends_s = WallClock().monotonic_s() + 30.0
    while (sheet := scorer.score(job(start=start, deadline_s=1e6))).scores[0].fault == "circuit-open":
        assert WallClock().monotonic_s() < ends_s, "the circuit stays open"
        clock.now_s += REST_MAX_S
    return sheet


def test_the_question_a_hung_server_is_tried_with_keeps_no_batch_waiting() -> None:
    scorer, chat, _ = opened(None)
    wall, asked = WallClock(), len(chat.asked)
    started_s = wall.monotonic_s()
    sheets = [scorer.score(job(start=start, deadline_s=20.0)) for start in (50, 60, 70)]
    assert wall.monotonic_s() - started_s < 10.0
    assert {score.fault for sheet in sheets for score in sheet.scores} == {"circuit-open"}
    assert len(chat.asked) <= asked + 1
    scorer.close()


def test_server_well_again_takes_over_and_its_trial_is_counted_and_not_asked_twice() -> None:
    scorer, chat, clock = opened(good)
    assert {score.fault for score in scorer.score(job(start=50, deadline_s=1e6)).scores} == {"circuit-open"}
    sheet = once_well(scorer, clock, 60)
    assert not any(score.fault for score in sheet.scores)
    assert sheet.usage.tokens_in == 200  # its own and the trial's
    asked = len(chat.asked)
    again = scorer.score(job(start=50))
    assert not any(score.fault for score in again.scores)
    assert (again.usage.cached, len(chat.asked)) == (3, asked)
    scorer.close()


def test_a_trial_that_hangs_ends_with_its_deadline_and_another_follows() -> None:
    scorer, chat, clock = opened(None)
    scorer.score(job(start=50, deadline_s=0.1))
    chat.script = [good]
    assert not any(score.fault for score in once_well(scorer, clock, 70).scores)
    scorer.close()


def test_a_first_probe_that_waits_for_another_question_does_not_make_more_side_by_side_look_worth_it() -> None:
    clock = HandClock()

    class OneAtATime(ScriptedChat):
        async def ask(self, question: Question) -> ChatResult:
            clock.now_s += 1.0 if clock.now_s else 10.0
            return await super().ask(question)

    scorer = LanguageModel("fake:m", OneAtATime(good), clock, 5.0)
    assert "1 questions side by side" in scorer.warm(lambda: False)
    scorer.close()


def test_talk_is_kept_word_for_word_up_to_a_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "transcript.jsonl"
    scorer = LanguageModel("fake:m", ScriptedChat(good), WallClock(), 5.0, transcript=TranscriptFile(path))
    sheet = scorer.score(job())
    scorer.close()
    (line,) = [json.loads(line) for line in path.read_text().splitlines()]
    assert line["prompt_digest"] == sheet.scores[0].prompt_digest
    assert line["messages"][0]["role"] == "system"
    assert "test_cases" in line["content"]
    monkeypatch.setattr(transcript, "FILE_BYTES_MAX", path.stat().st_size + 10)
    full = TranscriptFile(path)
    full(Exchange("m", "d", [], "x" * 100))
    assert len(path.read_text().splitlines()) == 1
    TranscriptFile(tmp_path / "no" / "folder")(Exchange("m", "d", [], "x"))


def test_words_that_no_message_can_hold_do_not_stop_the_scorer() -> None:
    def torn(question: Question) -> ChatResult:
        answer = good(question, interpretation="\ud800", effect="\udfff")
        return answer._replace(reply=answer.reply._replace(thinking="\ud800"))

    scorer, chat = model(torn)
    chat.digest = lambda: _said("\ud800")  # type: ignore[method-assign]
    scorer.warm(lambda: False)
    sheet = scorer.score(job())
    assert not any(score.fault for score in sheet.scores)
    assert {score.reason for score in sheet.scores} == {"? ?"}
    assert sheet.digest == "?"
    scorer.close()


async def _said(text: str) -> str:
    return text
