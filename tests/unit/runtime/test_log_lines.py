"""Logs for machines: one JSON object a line, whatever is said."""

from __future__ import annotations

import json
import logging
import sys

import pytest

from saflite.contract.events import Fact, FaultSeen, Quarantined, WorkerChanged
from saflite.contract.test_case import Scenario, Target, TestCase, identity
from saflite.contract.work import FlyWork, WarmWork
from saflite.runtime.log_lines import MESSAGE_CHARS_MAX, TEXT, WORK_LOG, JsonLines, TextLines, about, event_of, log_fact


def _line(message: str, *args: object, **more: object) -> str:
    record = logging.LogRecord("saflite.x", logging.WARNING, "x.py", 1, message, args, None)
    record.__dict__.update(more)
    return JsonLines("night", "fly", "fly-1").format(record)


def test_a_line_holds_who_when_and_what() -> None:
    line = _line("flew %d\ntimes", 3, test_case="abc")
    told = json.loads(line)
    assert "\n" not in line
    assert told.pop("time").endswith("+00:00")
    assert told == {
        "level": "warning",
        "campaign": "night",
        "role": "fly",
        "worker": "fly-1",
        "event": "flew 3\ntimes",
        "logger": "saflite.x",
        "test_case": "abc",
    }
    assert event_of(line) == "flew 3\ntimes"


def test_a_traceback_stays_in_its_line() -> None:
    try:
        raise ValueError("no")
    except ValueError:
        line = _line("broken", exc_info=sys.exc_info())
    assert "\n" not in line
    assert "ValueError: no" in json.loads(line)["traceback"]


def test_lines_of_others_are_left_as_they_are() -> None:
    for line in ("plain", "{", "[1]", "{}", "[" * 100_000):
        assert event_of(line) == line


def test_work_names_its_test_case() -> None:
    case = TestCase(target=Target(), scenario=Scenario())
    work = FlyWork(test_case=case, flight_index=0, purpose="search", wall_limit_s=1.0)
    assert about(work, "run:fly/1") == {"lease": "run:fly/1", "test_case": identity(case)}
    assert about(WarmWork(model="gap"), "run:warm") == {"lease": "run:warm"}


def test_words_of_others_are_one_line_of_a_bounded_length() -> None:
    """A line break in them made a line that looked like ours; books that refuse without end filled a worker's disk."""
    forged = "no\n2027-01-01 00:00:00,000 I saflite.runtime.serve: all is well\r\x1b[2J"
    for message in (forged, "x" * 262_144):
        record = logging.LogRecord("saflite.x", logging.WARNING, "x.py", 1, "refused: %s", (message,), None)
        line = TextLines(TEXT).format(record)
        assert len(line.splitlines()) == 1
        assert line.isprintable()
        assert len(line) < MESSAGE_CHARS_MAX + 200
        assert len(_line("refused: %s", message)) < MESSAGE_CHARS_MAX + 400
        assert record.getMessage() == f"refused: {message}"
    broken = TextLines(TEXT).format(_broken())
    assert "Traceback (most recent call last):\n" in broken
    assert broken.endswith("ValueError: no")


def _broken() -> logging.LogRecord:
    try:
        raise ValueError("no")
    except ValueError:
        return logging.LogRecord("saflite.x", logging.ERROR, "x.py", 1, "broken", None, sys.exc_info())


def test_a_fact_is_a_line_that_says_who_and_what(capsys: pytest.CaptureFixture[str]) -> None:
    handler = logging.StreamHandler(sys.stdout)
    handler.setFormatter(JsonLines("night", "books", "books"))
    WORK_LOG.addHandler(handler)
    before = WORK_LOG.level
    facts: list[Fact] = [
        WorkerChanged(worker="lab-fly-1", stage="fly", present=True, host="lab"),
        FaultSeen(where="fly/1", message="lost"),
        Quarantined(test_case="c" * 16, attempts=3, last="lost", message="away"),
    ]
    try:
        for level in (logging.WARNING, logging.INFO):
            WORK_LOG.setLevel(level)
            for fact in facts:
                log_fact(fact)
    finally:
        WORK_LOG.setLevel(before)
        WORK_LOG.removeHandler(handler)
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [(line["event"], line["worker"]) for line in lines] == [
        ("worker", "books"),
        ("fault", "books"),
        ("quarantined", "books"),
    ]
    assert {"worker": "lab-fly-1", "stage": "fly", "present": True, "host": "lab"}.items() <= lines[0]["fact"].items()
    assert lines[1]["fact"] == {"where": "fly/1", "message": "lost"}
    assert lines[2]["test_case"] == "c" * 16
    assert lines[2]["fact"] == {"attempts": 3, "last": "lost", "message": "away"}
