"""Question and answer of a language model fit the tokens there are, also where it is wordy or thinks."""

from __future__ import annotations

from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.scorer_pool.llm import scorer as llm_scorer
from saflite.scorer_pool.llm.allowance import MORE_TOKENS_MAX
from saflite.scorer_pool.llm.chat import ChatResult, Question
from saflite.scorer_pool.llm.parse import Reply
from saflite.scorer_pool.model import Job

from .test_llm import BRIEFS, good, job, model


def test_a_model_whose_answers_are_cut_off_is_given_more_room_from_then_on() -> None:
    def wordy(question: Question) -> ChatResult:
        done = good(question)
        return done if question.tokens_max >= 1200 else ChatResult(Reply(done.reply.content[:20]), cut=True)

    scorer, chat = model(wordy)
    assert [score.fault for score in scorer.score(job()).scores] == ["", "", ""]
    assert [question.tokens_max for question in chat.asked] == [600, 1200]
    assert not any(score.fault for score in scorer.score(job(start=10)).scores)
    assert len(chat.asked) == 3
    scorer.close()


def test_room_for_a_model_that_never_ends_stays_bounded() -> None:
    scorer, chat = model(lambda question: ChatResult(Reply("{"), cut=True))
    for place in range(4):
        scorer.score(job(start=10 * place))
    assert max(question.tokens_max for question in chat.asked) <= 600 + MORE_TOKENS_MAX
    scorer.close()


def test_questions_never_outgrow_the_context() -> None:
    given = [
        Stimulus(at_s=float(at), kind="command", name="MAV_CMD_" + "X" * 50, values=(1.0,) * 7) for at in range(30)
    ]
    long = tuple(
        TestCase(target=Target(), scenario=Scenario(start=StartState()), stimuli=tuple(given), rng_seed=seed)
        for seed in range(10)
    )
    scorer, chat = model(good)
    sheet = scorer.score(Job(long, BRIEFS))
    assert not any(score.fault for score in sheet.scores)
    assert len(chat.asked) > 1
    for question in chat.asked:
        size = sum(len(message["content"]) for message in question.messages)
        assert size <= llm_scorer.CHARS_PER_TOKEN * (llm_scorer.CONTEXT_TOKENS - question.tokens_max)
    scorer.close()
