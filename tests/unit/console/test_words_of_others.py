"""Whatever a worker, a file or a model says, wherever it is shown: no control, no hidden or turned text, no markup."""

from __future__ import annotations

import csv
import io
import json
import logging
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as Xml

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from saflite.console.operations import log_judging
from saflite.console.view import ci_files
from saflite.console.view.html_text import escape
from saflite.contract.plain import cell, plain, plain_data, plain_json, word
from saflite.contract.verdict import Judgement, Verdict
from saflite.recorder.exports import junit
from saflite.runtime.log_lines import JsonLines, TextLines
from saflite.scorer_pool.llm.transcript import Exchange, TranscriptFile

UNSAFE: tuple[Literal["Cc", "Cf", "Cs", "Zl", "Zp"], ...] = ("Cc", "Cf", "Cs", "Zl", "Zp")
WORDS = st.text(st.characters(codec=None), max_size=40)
"""Every code point, halves of surrogates among them, and above all those that steer."""

STEERING = st.text(st.characters(categories=UNSAFE), max_size=20)
SAID = st.one_of(
    *(WORDS, STEERING, st.builds("{}{}".format, st.sampled_from("=+-@<&\"'"), WORDS)),
    st.builds(
        "{}{}{}{}".format, WORDS, st.sampled_from((";", "|", "; ", "")), st.sampled_from("=+-@\uff1d\uff0b"), WORDS
    ),
)
FORMULAS = tuple("=+-@\uff1d\uff0b\uff20\uff0d")


def units(text: str) -> bytes:
    """A text as JSON counts it: two halves of a surrogate are one character there."""
    return text.encode("utf-16-be", "surrogatepass")


def steers(text: str, layout: str = "\n\t") -> bool:
    return any(unicodedata.category(char) in UNSAFE for char in text if char not in layout)


def of_junit(said: str) -> str:
    check = ci_files.Check(said, said, "failed", said, "warning", "new", said, said)
    text = ci_files.junit(said, [check])
    Xml.fromstring(text.encode())
    return text


def of_sarif(said: str) -> str:
    check = ci_files.Check(said, said, "failed", said, "warning", "new", said, said)
    text = json.dumps(plain_data(ci_files.sarif(said, [check])), indent=2, ensure_ascii=False)
    text.encode()
    for one in json.loads(text)["runs"][0]["results"]:
        assert not steers(one["message"]["text"])
    return text


def of_page(said: str) -> str:
    text = escape(said)
    assert not set("<>\"'") & set(text)
    return text


def of_csv(said: str) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow([cell(said), cell(-1.5)])
    (row,) = csv.reader(text.getvalue().splitlines())
    assert row[1] == "-1.5"
    for delimiter in ",;|":  # as programs for tables part it, by the language they are set up for
        (cells,) = csv.reader([text.getvalue().removesuffix(",-1.5\n")], delimiter=delimiter)
        assert not any(one.strip().startswith(FORMULAS) for one in cells if delimiter != "," or one is cells[0])
    return text.getvalue()


def of_log(said: str) -> str:
    return TextLines("%(message)s").format(logging.LogRecord("x", 20, "", 0, said, None, None))


def of_json_log(said: str) -> str:
    line = JsonLines("c", "r", "w").format(logging.LogRecord("x", 20, "", 0, said, None, None))
    assert units(json.loads(line)["event"]) == units(said), "the same, not the same to the eye"
    return line


def of_json(said: str) -> str:
    text = plain_json(json.dumps(said, ensure_ascii=False))
    assert units(json.loads(text)) == units(said)
    return text


PLACES: tuple[Callable[[str], str], ...] = (
    *(of_junit, of_sarif, of_page, of_csv, of_log, of_json_log, of_json),
    *(junit.clean, plain, word),
)


@pytest.mark.parametrize("place", PLACES, ids=lambda one: one.__name__)
@given(said=SAID)
@example(said="\x1b[2J\x9b31m\u202egnp.exe\u2028\ud800\ufffe\U000e0041\u200b\x00")
@example(said="=cmd|' /C calc'!A1")
@example(said="]]><script>alert(1)</script>")
def test_words_of_others_steer_nothing(place: Callable[[str], str], said: str) -> None:
    text = place(said)
    assert not steers(text)
    text.encode()  # no half of a surrogate is left


@given(said=SAID)
def test_a_transcript_holds_what_was_said_and_steers_no_terminal(
    said: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("said") / "transcript.jsonl"
    fields = dict.fromkeys(Exchange._fields, said)
    TranscriptFile(path)(Exchange(**fields))  # type: ignore[arg-type]  # words will do for any field
    text = path.read_text()
    assert not steers(text)
    assert {name: units(value) for name, value in json.loads(text).items()} == dict.fromkeys(fields, units(said))


def test_what_a_log_says_steers_no_table(tmp_path: Path) -> None:
    evil = "\x1b[2J=1+1\u202e"
    verdict = Verdict(policy="p", outcome="inconclusive", message=f"={evil}")
    judged = [
        log_judging.Judged(tmp_path / evil, refused=evil),
        log_judging.Judged(tmp_path, judgement=Judgement(test_case="0" * 16, flight_index=0, verdicts=(verdict,))),
    ]
    for text in (log_judging.as_csv(judged).decode(), log_judging.as_html(judged).decode()):
        assert not steers(text)
    assert msgspec.json.encode(log_judging.as_json(judged))
