"""Whoever asks for a twin is told how far apart the two were, also where no rule has anything to say of it."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from saflite.console.cli import main
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus, Target, TestCase

BOX = Obstacle(length_m=5.0, width_m=5.0, height_m=10.0, x_m=20.0, y_m=30.0, rotation_deg=0.0)
CASE = TestCase(
    target=Target(),
    scenario=Scenario(start=StartState(mode="LOITER", altitude_m=20.0), obstacles=(BOX,), time_limit_s=5.0),
    stimuli=(Stimulus(at_s=1.0, kind="stick", name="RC1", values=(1800.0,)),),
)


def test_a_twin_of_which_no_rule_speaks_is_told_with_its_distance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = tmp_path / "case.json"
    case.write_bytes(msgspec.json.encode(CASE))
    words = ["fly", str(case), "--twin", "turned", "--policy", "turned-alike", "--policy", "upright"]
    assert main(words) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("twin ")]
    assert line.startswith("twin       turned: at most ")
    assert line.endswith("; turned-alike is vacuous: the rule never applied")
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["twin"]
    assert (said["compared"], said["asked"]) == (True, "turned")
    assert said["apart_m"] == pytest.approx(float(line.split()[4]), rel=0.01)


def test_a_flight_without_a_twin_tells_of_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = tmp_path / "case.json"
    case.write_bytes(msgspec.json.encode(CASE))
    assert main(["fly", str(case), "--policy", "upright"]) == 0
    assert "twin" not in capsys.readouterr().out
