"""Logs for machines: one JSON object a line, whatever is said."""

from __future__ import annotations

import json
import logging
import sys

from saflite.contract.test_case import Scenario, Target, TestCase, identity
from saflite.contract.work import FlyWork, WarmWork
from saflite.runtime.log_lines import JsonLines, about, event_of


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
