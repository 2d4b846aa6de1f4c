"""Every command that reads a file of others warns of what the file says and no flight heeds, once a file."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from saflite.console.cli import main
from saflite.contract.gaps import TOLD_MAX
from saflite.flight.mission import builtin_mission, dump_plan
from saflite.recorder.exports.aerialist import read_case

CASE = """\
robot: {mission_file: mission2.plan}
simulation:
  timeout: 20
  obstacle:
  - size: {l: 5, w: 5, h: 15}
    position: {x: 20, y: 30, z: 0, r: 0}
"""
WARNED = "saflite: warning: case.yaml, line 4: `simulation.obstacle` is unknown and not flown; did you mean"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mission2.plan").write_text(dump_plan(builtin_mission("mission2")))
    (tmp_path / "case.yaml").write_text(CASE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def warnings(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    assert main(words) in (0, 1, 4)
    said = capsys.readouterr()
    assert "warning" not in said.out
    return [line for line in said.err.splitlines() if "warning" in line]


@pytest.mark.parametrize(
    "words",
    [
        ["fly", "case.yaml", "--json", "--policy", "min-obstacle-distance"],
        ["score", "case.yaml", "case.yaml", "--scorer", "surrogate", "--json"],
        ["replay", "case.yaml", "--json"],
        ["flake", "case.yaml", "-n", "2", "--policy", "upright", "--json"],
    ],
)
def test_each_command_tells_of_it_once(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):  # another command in the same process tells it again
        (told,) = warnings(capsys, *words)
        assert told.startswith(WARNED)


def test_a_folder_of_flights_judged_with_one_case_tells_of_it_once(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("one", "two"):
        warnings(capsys, "fly", "case.yaml", "--out", f"{name}.mcap", "--policy", "upright")
    (told,) = warnings(capsys, "judge", ".", "--test-case", "case.yaml", "--policy", "upright")
    assert told.startswith(WARNED)


FENCE = {"circles": [{"circle": {"center": [47.0, 8.0], "radius": 20.0}, "inclusion": True}], "polygons": []}


@pytest.mark.parametrize(
    "words",
    [
        ["score", "case.yaml", "other.yaml", "--scorer", "surrogate"],
        ["score", "case.json", "--scorer", "surrogate"],
        ["mutate", "mine.toml", "--count", "1"],
    ],
)
def test_each_command_tells_once_of_the_plan_beside_a_file(
    words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = json.loads((folder / "mission2.plan").read_text()) | {"geoFence": FENCE}
    (folder / "mission2.plan").write_text(json.dumps(plan))
    (folder / "case.yaml").write_text(CASE.replace("obstacle:", "obstacles:"))
    (folder / "other.yaml").write_text(CASE.replace("obstacle:", "obstacles:"))
    (folder / "case.json").write_bytes(msgspec.json.encode(read_case(folder / "case.yaml")))
    (folder / "mine.toml").write_text('name = "mine"\nmission = "mission2.plan"\n')
    (told,) = warnings(capsys, *words)
    assert "`geoFence` (circles) is not flown" in told
    assert "mission2.plan: " in told or "case.json: " in told


@pytest.mark.parametrize(
    ("place", "word", "near"),
    [
        (("scenario",), "obstacle", "obstacles"),
        (("scenario", "wind"), "mean_mp", "mean_mps"),
        (("scenario", "mission", "items", 0), "comand", "command"),
        (("target",), "xyzzy", ""),
        ((), "stimulus", "stimuli"),
    ],
)
def test_words_unknown_to_a_test_case_of_ours_are_told(
    place: tuple[str | int, ...], word: str, near: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "case.yaml").write_text(CASE.replace("obstacle:", "obstacles:"))
    data = part = msgspec.to_builtins(read_case(folder / "case.yaml"))
    (folder / "case.json").write_text(json.dumps(data))
    assert warnings(capsys, "score", "case.json", "--scorer", "surrogate") == []
    for key in place:
        part = part[key]
    part[word] = 3
    (folder / "case.json").write_text(json.dumps(data))
    (told,) = warnings(capsys, "score", "case.json", "--scorer", "surrogate")
    named = ".".join(map(str, (*place, word))).replace(".0", "[0]")
    ask = f" (`{near}`?)" if near else ""
    assert told == f"saflite: warning: case.json: `{named}` is unknown{ask} and not flown"


def test_of_endless_unknown_words_some_are_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "case.yaml").write_text(CASE.replace("obstacle:", "obstacles:"))
    data = msgspec.to_builtins(read_case(folder / "case.yaml")) | {f"word{number}": 1 for number in range(100_000)}
    (folder / "case.json").write_text(json.dumps(data))
    assert len(warnings(capsys, "score", "case.json", "--scorer", "surrogate")) == TOLD_MAX
