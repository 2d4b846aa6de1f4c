"""Reading answers: 500 made ones give exactly what may be read, 10,000 mutated ones never a wrong pairing."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from saflite.contract.rng import derive
from saflite.contract.score import band
from saflite.scorer_pool.llm.parse import Reply, parse

from .answers import KINDS, Answer, answer, corpus, mutated

CORPUS = corpus()


def test_corpus_is_large_and_holds_every_kind() -> None:
    assert len(CORPUS) >= 500
    assert {made.kind for made in CORPUS} == set(KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_reads_what_stands_there_and_names_the_fault_otherwise(kind: str) -> None:
    for made in (made for made in CORPUS if made.kind == kind):
        got = parse(made.reply, made.keys)
        assert set(got.lines) | set(got.faults) == set(made.keys)
        assert not set(got.lines) & set(got.faults)
        for key, expected in made.expected.items():
            if isinstance(expected, float):
                assert got.lines[key].value == expected
            else:
                assert got.faults[key] in expected.split("|"), (kind, got.faults[key])


def stands_in(text: str, key: str, value: float) -> bool:
    """Return whether an object of `text` pairs the key with the score: found by pattern, not by the reader itself."""
    flat = re.sub(r'"(?!id"|score")(?:[^"\\]|\\.)*"\s*:\s*"(?:[^"\\]|\\.)*"', '""', text)
    for found in re.finditer(r'(?:"([^"]*)"\s*:\s*)?(\{[^{}]*\})', flat):
        scores = re.findall(r'"score"\s*:\s*(-?[\d.eE+-]+)', found.group(2))
        ids = re.findall(r'"id"\s*:\s*"([^"]*)"', found.group(2)) or [found.group(1)]
        if ids == [key] and len(scores) == 1 and float(scores[0]) == value:
            return True
    return False


def test_mutated_answers_never_raise_and_never_pair_wrongly() -> None:
    readable = 0
    makers = [kind for kind in KINDS if kind not in {"ten_megabytes", "deep", "deep_object", "bytes"}]
    for seed in range(10_000):
        rng = derive(seed, "mutated answers")
        made: Answer = answer(makers[seed % len(makers)], seed % 50)
        content, thinking = mutated(made.reply.content, rng), mutated(made.reply.thinking, rng)
        got = parse(Reply(content, thinking), made.keys)
        assert set(got.lines) | set(got.faults) == set(made.keys)
        for key, line in got.lines.items():
            assert 0.0 <= line.value <= 10.0
            assert stands_in(content, key, line.value) or stands_in(thinking, key, line.value), f"seed {seed}"
            readable += 1
    assert readable > 2_000, "mutations so strong that the test says nothing"


def test_a_score_in_words_of_a_reason_is_not_taken() -> None:
    text = '{"test_cases": {"ca": {"interpretation": "\\"score\\": 9", "effect": "", "score": "9/10"}}}'
    assert parse(Reply(text), ("ca",)).faults == {"ca": "not-a-number"}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ('{"test_cases": {"ca": {"score": 3}, "ca": {"score": 4}}}', "duplicate"),
        ('{"test_cases": {"cb": {"score": 3}}}', "wrong-ids"),
        ('{"test_cases": {"ca": {"id": "cb", "score": 3}}}', "schema"),
        ('{"test_cases": {"ca": 3}}', "schema"),
    ],
)
def test_object_by_id_is_held_to_the_same_rules(text: str, fault: str) -> None:
    assert parse(Reply(text), ("ca",)).faults == {"ca": fault}


def test_says_its_faults_in_one_line() -> None:
    assert parse(Reply("no"), ("ca", "cb")).fault == "not-json (2 ids)"


def ranked(scores: Mapping[str, float], ranking: object) -> dict[str, float]:
    told = {key: {"score": score} for key, score in scores.items()}
    reply = Reply(json.dumps({"test_cases": told, "ranking": ranking}))
    return {key: line.ranked for key, line in parse(reply, tuple(scores)).lines.items()}


def test_a_ranking_tells_equal_scores_apart_and_no_others() -> None:
    scores = {"a": 7, "b": 8, "c": 7, "d": 10}
    got = ranked(scores, ["c", "a", "b", "d"])
    assert sorted(got, key=lambda key: -got[key]) == ["d", "b", "c", "a"]
    assert all(abs(value - scores[key]) < 0.5 for key, value in got.items())
    assert max(got.values()) <= 10.0


SCORES = st.one_of(st.integers(0, 10), st.integers(0, 100).map(lambda tenths: tenths / 10), st.floats(0, 10))


@given(st.lists(SCORES, min_size=2, max_size=8), st.randoms())
def test_a_ranking_moves_nothing_past_another_score_or_out_of_its_band(values: list[float], random: Random) -> None:
    """7 became 7.4, which is interesting, 3.8 became 4.2, and all that were 10 stayed equal."""
    scores = {f"c{number}": float(value) for number, value in enumerate(values)}
    ranking = sorted(scores, key=lambda _: random.random())
    got = ranked(scores, ranking)
    for key, value in got.items():
        assert 0.0 <= value <= 10.0
        assert band(value) == band(scores[key])
        for other in got:
            if scores[other] < scores[key]:
                assert got[other] <= value
            elif scores[other] == scores[key] and ranking.index(key) < ranking.index(other):
                assert got[other] < value or not all(float(one).is_integer() for one in values)


@pytest.mark.parametrize("ranking", [None, "cab", [], ["a", "b"], ["a", "b", "c", "c"], [1, 2, 3], {"a": 1}])
def test_a_ranking_that_is_none_changes_nothing(ranking: object) -> None:
    scores = {"a": 7, "b": 7, "c": 7}
    assert ranked(scores, ranking) == scores


@pytest.mark.parametrize("part", ["<think>", "<thinking>a", "</think>", "<think></think>", "<think>a</thinking>b"])
def test_an_answer_full_of_marks_is_read_in_a_moment(part: str) -> None:
    """A million characters of beginnings took a quarter of an hour, and no deadline ends a pattern."""
    began_s = time.process_time()
    assert parse(Reply((part * 1_000_000)[:1_000_000]), ("k1",)).faults
    assert time.process_time() - began_s < 2.0, "measured: 0.1 s"


@pytest.mark.parametrize(
    ("text", "thought"),
    [
        ("<think>one</think>{S}<thinking>two</thinking>", ""),
        ("{S}", ""),
        ("<think>not ended {S}", ""),
        ("</think>{S}<think>", ""),
        ("<think>a<think>b</think>{S}", ""),
    ],
)
def test_what_is_thought_is_no_answer(text: str, thought: str) -> None:
    score = '{"test_cases": [{"id": "k1", "reason": "r", "score": 7}]}'
    assert "k1" in parse(Reply(text.replace("{S}", score), thought), ("k1",)).lines
