"""The paper's questions one and two: counts that add up, chances that are chances, faults that are named."""

from __future__ import annotations

import json
import math

import msgspec
import pytest

from saflite.console.evaluation import logs as logs_module
from saflite.console.evaluation.bugs import BugResult, bugs, evaluate_bug, gain, question, value_of
from saflite.console.evaluation.logs import RULE, LogCase, evaluate_logs
from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.mutator.operators.inputs import published_inputs
from saflite.runtime.clock import WallClock
from saflite.runtime.stages import brief_of
from saflite.scorer_pool.llm.case_text import values_text
from saflite.scorer_pool.llm.chat import ChatResult, Question
from saflite.scorer_pool.llm.parse import Reply
from saflite.scorer_pool.llm.prompt import build
from saflite.scorer_pool.llm.scorer import LanguageModel

CLOCK = WallClock()


def test_ten_bugs_with_policies_and_lists_that_exist() -> None:
    assert len(bugs()) == 10
    for bug in bugs():
        assert brief_of(bug.policy).interestingness
        asked = question(bug, published_inputs(bug.list), 1)
        assert len(asked.test_cases) == len(published_inputs(bug.list))


def test_appendix_inputs_render_from_policy_files() -> None:
    bug = bugs()[1]
    asked = question(bug, published_inputs(bug.list), 1)
    prompt = build(asked.test_cases[:3], (brief_of(bug.policy)._replace(state=bug.state),))
    assert "Policy a-chute" in prompt.user
    assert "flight mode FLIP" in prompt.user
    assert "parachute" in prompt.user


def test_every_input_is_asked_with_a_value_by_the_published_rules() -> None:
    inputs = {listed.name: listed for listed in published_inputs("A.ALT_HOLD2")}
    rng = derive(1, "values")
    assert value_of(inputs["GND_TEMP"], rng) == (0.0,)  # no bounds: the published generator only ever gives 0
    assert 0.0 <= value_of(inputs["ATC_RAT_RLL_FF"], rng)[0] <= 0.5
    assert len(value_of(inputs["MAV_CMD_NAV_TAKEOFF"], rng)) == 7
    assert value_of(inputs["MAV_CMD_DO_PARACHUTE"], rng) == (2.0,)
    assert 1000 <= value_of(inputs["RC3"], rng)[0] <= 2000


def test_trigger_has_the_value_of_the_report() -> None:
    bug = next(bug for bug in bugs() if bug.id == "133")
    asked = question(bug, published_inputs(bug.list), 1)
    texts = [values_text(case) for case in asked.test_cases]
    assert sum("COM_POS_FS_DELAY = -1" in text for text in texts) == 1


@pytest.mark.parametrize("model", ["constant", "random", "relevance"])
def test_figures_of_a_bug_add_up(model: str) -> None:
    bug = bugs()[0]
    got = evaluate_bug(bug, model, published_inputs, brief_of, CLOCK)
    assert sum(got.bands.values()) == pytest.approx(100.0)
    assert 1 <= got.trigger_rank <= got.inputs
    assert got.scored_by == {model: got.inputs}
    assert got.chance_pgfuzz == pytest.approx(1 / 53 / 3)
    if model == "constant":
        assert got.trigger_rank == (got.inputs + 1) / 2
        assert got.chance_weighted == pytest.approx(got.chance_uniform)


def test_gain_counts_bugs_of_one_trigger_as_one() -> None:
    one = evaluate_bug(bugs()[0], "constant", published_inputs, brief_of, CLOCK)

    def worth(trigger: str, times: float) -> BugResult:
        changed: BugResult = msgspec.structs.replace(
            one, trigger=trigger, chance_pgfuzz=0.01, chance_weighted=0.01 * times
        )
        return changed

    assert gain([worth("a", 4.0), worth("a", 1.0)]).value == pytest.approx(2.0)
    assert gain([worth("a", 4.0), worth("a", 1.0)]).low is None, "one trigger says nothing of others"
    found = gain([worth("a", 8.0), worth("a", 8.0), worth("a", 8.0), worth("b", 2.0)])
    assert found.value == pytest.approx(4.0), "not the mean over four bugs, 5.7"
    assert found.low is not None
    assert found.high is not None
    # logarithms 3 ln 2 and ln 2: standard error ln 2, Student's factor for one degree of freedom 12.706
    assert found.high / 4.0 == pytest.approx(math.exp(12.706 * math.log(2)), rel=1e-3)
    assert found.low * found.high == pytest.approx(16.0)
    assert gain([]).value is None


class ReadingChat:
    """Calls a log interesting where the word crash stands in it; has no answer for one of them."""

    async def ask(self, question: Question) -> ChatResult:
        text = question.messages[-1]["content"]
        if "ready" in question.schema["properties"] or "silent" in text:
            return ChatResult(Reply("hm"))
        row = {"interpretation": "i", "effect": "e", "score": 9 if "crash" in text else 1}
        return ChatResult(Reply(json.dumps({"test_cases": {"log": row}})))

    async def load(self) -> str:
        return "loaded"

    async def digest(self) -> str:
        return "d"


LOGS = [
    LogCase("a", "calm", False, 0.0),
    LogCase("b", "a crash", True, 8.0),
    LogCase("c", "crash landing", False, 2.0),
    LogCase("d", "silent", True, 9.0),
    LogCase("e", "calm", None, 1.0),
]


def test_answers_meet_labels_and_faults_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(logs_module, "make", lambda label, tools: LanguageModel(label, ReadingChat(), tools.clock, 5.0))
    report = evaluate_logs(LOGS, "fake:m", CLOCK)
    assert (report.labelled, report.unlabelled) == (4, 1)
    assert report.unanswered == {"fake:m": 1, "random": 0, RULE: 0}
    mine = next(one for one in report.calibrations if one.model == "fake:m")
    cells = mine.metrics.confusion
    counted = (cells.true_positive, cells.false_positive, cells.false_negative, cells.true_negative)
    assert counted == (1, 1, 0, 1)
    rule = next(one for one in report.calibrations if one.model == RULE)
    assert rule.metrics.accuracy.value == 1.0
    silent = next(answer for answer in report.answers if answer.log == "d" and answer.answerer == "fake:m")
    assert (silent.score, silent.fault) == (None, "not-json")


def test_rule_of_thumb_needs_no_server_and_embedded_models_cannot_read() -> None:
    report = evaluate_logs(LOGS, RULE, CLOCK)
    assert {answer.answerer for answer in report.answers} == {RULE, "random"}
    assert all(answer.score is None or math.isfinite(answer.score) for answer in report.answers)
    with pytest.raises(Refused):
        evaluate_logs(LOGS, "constant", CLOCK)
    with pytest.raises(Refused):
        evaluate_logs([], RULE, CLOCK)
