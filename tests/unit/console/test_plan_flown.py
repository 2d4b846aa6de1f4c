"""A mission plan is a test case as it stands: who has one flies it without writing a campaign first."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.console.io.cases import load_case
from saflite.console.operations import judging
from saflite.contract.flight import Flight
from saflite.flight.mission import builtin_mission, dump_plan


def test_a_plan_is_the_mission_that_it_holds_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "survey.plan"
    path.write_text(dump_plan(builtin_mission("mission2")), encoding="utf-8")
    case = load_case(path)
    assert case.scenario.mission is not None
    assert case.scenario.mission.items == builtin_mission("mission2").items
    assert (case.scenario.start, case.scenario.obstacles, case.stimuli) == (None, (), ())


def test_the_flight_of_a_plan_is_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "survey.plan"
    path.write_text(dump_plan(builtin_mission("mission2")), encoding="utf-8")
    assert main(["fly", str(path), "--policy", "mission-in-order", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["judgement"]["verdicts"][0]["outcome"] == "held"


def test_a_file_that_is_no_plan_is_refused_by_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fence.plan"
    path.write_text('{"fileType": "Plan", "geoFence": {}}', encoding="utf-8")
    assert main(["fly", str(path)]) == 2
    assert str(path) in capsys.readouterr().err


def test_what_the_autopilot_left_is_written_even_where_its_flight_cannot_be_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = Flight(test_case="", flight_index=0, ending="infra", message="the link broke")
    files = (("console.txt", b"Booting\n"), ("dataflash.bin", b"\xa3\x95"))
    monkeypatch.setattr(judging, "fly", lambda *_: judging.Flown(ended, b"", files))
    path, left = tmp_path / "survey.plan", tmp_path / "left"
    path.write_text(dump_plan(builtin_mission("mission2")), encoding="utf-8")
    assert main(["fly", str(path), "--artefacts", str(left)]) == 3
    assert "the link broke" in capsys.readouterr().err
    assert {one.name: one.read_bytes() for one in left.iterdir()} == dict(files)
    assert main(["fly", str(path), "--artefacts", str(left)]) == 2, "what stands there is not written over"
