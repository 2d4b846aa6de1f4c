"""A finding on ArduPilot as a script: what it holds, what stays at home."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from saflite.contract.errors import Refused
from saflite.contract.standalone import Evidence
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.autopilots.ardupilot.mission import as_taken
from saflite.flight.autopilots.ardupilot.standalone.export import files_of
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.mission import builtin_mission, parse_plan

REAL32, INT16 = 9, 4
LISTING = Listing(
    binary="0" * 64,
    parameters={
        "RTL_ALT": Row(1500.0, INT16),
        "FENCE_ENABLE": Row(0.0, INT16),
        "ATC_RAT_RLL_P": Row(0.135, REAL32),
    },
)


def test_a_finding_leaves_as_a_script_that_python_takes() -> None:
    boxes = Scenario(obstacles=(Obstacle(length_m=5, width_m=5, height_m=20, x_m=20, y_m=0),))
    case = TestCase(
        target=Target(name="ardupilot", parameters={"RTL_ALT": 900.0, "ATC_RAT_RLL_P": 0.2}),
        scenario=Scenario(start=StartState(mode="GUIDED", altitude_m=20.0), time_limit_s=30.0),
        stimuli=(
            Stimulus(at_s=5.0, kind="mode", name="RTL"),
            Stimulus(at_s=2.0, kind="parameter", name="FENCE_ENABLE", values=(1.0,)),
        ),
    )
    told = Evidence("finding.py", "a-rtl1", 'RTL "climbs"', 6.0, 8.0, {"ranges": "all inside"}, ["5 s: mode RTL"])
    flight = cast(Any, SimpleNamespace(ending="completed"))
    known = Binary(Path("/nowhere/arducopter"), "ab" * 32, "ArduCopter V4.5.7")
    files = files_of(case, flight, told, known, LISTING)
    text = files["finding.py"]
    tree = ast.parse(text)
    assert 'RTL "climbs"' in (ast.get_docstring(tree) or "")
    assert "/nowhere" not in text
    facts = json.loads(text.partition('json.loads(r"""')[2].partition('""")')[0])
    assert [one["name"] for one in facts["inputs"]] == ["FENCE_ENABLE", "RTL"]
    assert facts["inputs"][0]["number"] == INT16
    assert facts["parameters"] == {"RTL_ALT": 900.0, "ATC_RAT_RLL_P": 0.2}
    assert files["finding.parm"] == "ATC_RAT_RLL_P 0.2\nRTL_ALT 900\n"
    assert "5 s: mode RTL" in files["finding-steps.txt"]
    case_of_theirs = ast.parse(files["finding-autotest.py"])
    assert "finding-autotest.py build" in (ast.get_docstring(case_of_theirs) or "")
    assert list(files) == ["finding.py", "finding-autotest.py", "finding.parm", "finding-steps.txt"]
    with pytest.raises(Refused, match="without boxes"):
        files_of(msgspec.structs.replace(case, scenario=boxes), flight, told, known, LISTING)


def test_gains_for_our_frame_stay_at_home() -> None:
    told = Evidence("finding.py", "a-rtl1", "RTL climbs", 6.0, 8.0, {}, [])
    known = Binary(Path("arducopter"), "ab" * 32, "ArduCopter V4.5.7")
    flight = cast(Any, SimpleNamespace(ending="completed"))
    case = TestCase(target=Target(name="ardupilot"), scenario=Scenario())
    text = files_of(case, flight, told, known, LISTING)["finding.py"]
    assert "ATC_RAT_RLL_P" not in text


def test_a_mission_leaves_as_a_plan_too() -> None:
    told = Evidence("finding.py", "a-auto1", "AUTO flies on", 6.0, 8.0, {}, [])
    known = Binary(Path("arducopter"), "ab" * 32, "ArduCopter V4.5.7")
    flight = cast(Any, SimpleNamespace(ending="completed"))
    mission = builtin_mission("mission2")
    case = TestCase(target=Target(name="ardupilot"), scenario=Scenario(mission=mission))
    files = files_of(case, flight, told, known, LISTING)
    read = parse_plan(files["finding.plan"], "finding.plan", mission.name)
    assert read == as_taken(mission)


HOSTILE = (
    '{"@FACTS@": 0}',
    "@DESCRIPTION@",
    '""" + __import__("os").system("touch pwned") + """',
    "ends in a backslash \\",
    '"""""',
    '\\"""\nraise SystemExit',
)


@pytest.mark.parametrize("words", HOSTILE)
def test_no_words_of_a_run_are_anything_but_words_in_a_script(words: str) -> None:
    told = Evidence("finding.py", "a-auto1", words, 6.0, 8.0, {words: words}, [words])
    known = Binary(Path("arducopter"), "ab" * 32, "ArduCopter V4.5.7")
    flight = cast(Any, SimpleNamespace(ending="completed"))
    case = TestCase(target=Target(name="ardupilot"), scenario=Scenario())
    files, honest = (
        files_of(case, flight, one, known, LISTING) for one in (told, told._replace(title="T", asked={}, steps=[]))
    )
    for name in ("finding.py", "finding-autotest.py"):
        (described, *program), (_, *expected) = (ast.parse(one[name]).body for one in (files, honest))
        assert isinstance(described, ast.Expr)
        facts = next(one for one in program if isinstance(one, ast.AnnAssign))
        assert json.loads(facts.value.args[0].value)["title"] == words  # type: ignore[union-attr]
        rest = [[ast.dump(one) for one in body if one is not facts] for body in (program, expected)]
        assert [line for line in rest[1] if "json" not in line] == [line for line in rest[0] if "json" not in line]
