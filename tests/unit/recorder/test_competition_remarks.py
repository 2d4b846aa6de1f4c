"""What a competition document says in vain is told with its line, and what would move a box is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from saflite.contract.errors import Refused
from saflite.contract.test_case import TestCase, Wind
from saflite.flight.competition import remarks, yaml_text
from saflite.flight.competition.document import PLAN_WORDS, ROBOT_WORDS
from saflite.flight.mission import builtin_mission, dump_plan
from saflite.recorder.exports.aerialist import parse_case, read_case, write_case

PLAIN = """\
robot:
  port: ros
  params: {NAV_ACC_RAD: 0.5, MY_OWN: 3}
  mission_file: mission2.plan
simulation:
  simulator: ros
  world: default
  speed: 1
  headless: true
  home_position: [47.3977419, 8.5455938, 488.7858]
  timeout: 300
  wind:
    velocity_mean: 3
    velocity_max: 5
    direction: [0, 1, 0]
    velocity_variance: 0
    gust_start: 10
    gust_direction: [1, 0, 0]
  obstacles:
  - size: {l: 10, w: 5, h: 20}
    position: {x: 10, y: 20, z: 0, r: 0}
    shape: box
mission:
  commands: [{timestamp: 1, mode: 3, x: 0, y: 0, z: 0.5, r: 0}]
assertion: {variable: trajectory}
agent: {engine: docker, count: 3}
saflite: {rng_seed: 7}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mission2.plan").write_text(dump_plan(builtin_mission("mission2")))
    return tmp_path


def told(text: str, folder: Path) -> list[str]:
    found: list[str] = []
    parse_case(text, "case.yaml", folder, found.append)
    return found


def test_nothing_is_told_of_a_document_that_is_flown_as_it_says(folder: Path) -> None:
    assert told(PLAIN, folder) == []


@pytest.mark.parametrize(
    ("before", "after", "line", "word", "near"),
    [
        ("  obstacles:", "  obstacle:", 19, "simulation.obstacle", "simulation.obstacles"),
        ("  obstacles:", "obstacles:", 19, "obstacles", "simulation.obstacles"),
        ("  wind:", "  winds:", 12, "simulation.winds", "simulation.wind"),
        ("  timeout:", "  time_out:", 11, "simulation.time_out", "simulation.timeout"),
        ("simulation:", "Simulation:", 5, "Simulation", "simulation"),
        ("    velocity_max:", "    velocity:", 14, "simulation.wind.velocity", "simulation.wind.velocity_max"),
        ("  port:", "  obstacles:", 2, "robot.obstacles", "simulation.obstacles"),
        ("  commands:", "  command:", 24, "mission.command", "mission.commands"),
        ("agent: {engine: docker", "agent: {wind: docker", 26, "agent.wind", "simulation.wind"),
        ("assertion:", "xyzzy:", 25, "xyzzy", ""),
    ],
)
def test_words_that_are_unknown_where_they_stand_are_told(
    before: str, after: str, line: int, word: str, near: str, folder: Path
) -> None:
    found = told(PLAIN.replace(before, after, 1), folder)
    ask = f"; did you mean `{near}`?" if near else ""
    assert f"case.yaml, line {line}: `{word}` is unknown and not flown{ask}" in found


@pytest.mark.parametrize(
    ("before", "after", "line", "word"),
    [
        ("z: 0, r: 0}", "z: 0, angle: 90}", 21, "angle"),
        ("z: 0, r: 0}", "Z: 0, r: 0}", 21, "Z"),
        ("h: 20}", "h: 20, r: 90}", 20, "r"),
        ("h: 20}", "h: 20, depth: 3}", 20, "depth"),
        ("shape: box", "rotation: 90", 22, "rotation"),
        ("shape: box", "shap: cylinder", 22, "shap"),
    ],
)
def test_unknown_words_of_a_box_are_refused(before: str, after: str, line: int, word: str, folder: Path) -> None:
    with pytest.raises(Refused, match=word) as refusal:
        told(PLAIN.replace(before, after), folder)
    assert refusal.value.where == f"case.yaml, line {line}"
    assert "one of " in refusal.value.expected


@pytest.mark.parametrize(
    ("before", "after", "line", "words"),
    [
        ("velocity_max: 5", "velocity_max: 2", 14, "`velocity_max` is below `velocity_mean`"),
        ("[0, 1, 0]", "[0, 3, 4]", 15, "60% of the wind"),
        ("velocity_variance: 0", "velocity_variance: 2", 16, "`velocity_variance` of the wind is not flown"),
        ("gust_start: 10", "gust_duration: 10", 17, "`gust_duration` of the wind is not flown"),
        ("gust_start: 10", "gust_velocity_mean: 1", 17, "`gust_velocity_mean` of the wind is not flown"),
        ("world: default", "world: forest", 7, "`simulation.world` is not flown"),
        ("[47.3977419, 8.5455938,", "[47.3987419, 8.5455938,", 10, "`simulation.home_position` is not flown"),
        ("mode: 3", "mode: 4", 24, "`mission.commands`"),
        ("  commands:", "  waypoints: [{x: 1, y: 2}]\n  commands:", 24, "`mission.waypoints` are not flown"),
        ("mission:\n", "test: {speed: 1}\nmission:\n", 23, "`test` is not read, since `mission` is there"),
        ("simulation:\n", "drone: {port: ros}\nsimulation:\n", 5, "`drone` is not read, since `robot` is there"),
        ("{rng_seed: 7}", "{wind: {mean_mps: 4}}", 12, "`simulation.wind` is not flown, since `saflite.wind`"),
        ("{rng_seed: 7}", "{time_limit_s: 20}", 11, "`simulation.timeout` is not flown, since `saflite.time_limit_s`"),
    ],
)
def test_known_words_that_are_not_flown_are_told(before: str, after: str, line: int, words: str, folder: Path) -> None:
    (found,) = told(PLAIN.replace(before, after), folder)
    assert found.startswith(f"case.yaml, line {line}: ")
    assert words in found


FLOWN = {
    *(f"{word}.mission_file" for word in ROBOT_WORDS),
    *("simulation.obstacles", "simulation.timeout", "simulation.wind"),
    *(f"simulation.wind.{word}" for word in ("velocity_mean", "velocity_max", "direction")),
}
CHANGES_NO_FLIGHT = {
    *(f"{word}.port" for word in ROBOT_WORDS),
    *(f"{word}.params" for word in ROBOT_WORDS),  # of the real autopilot: kept, as the page on files says
    *("simulation.simulator", "simulation.speed", "simulation.headless"),
    *("simulation.wind.gust_start", "simulation.wind.gust_direction"),  # of a gust, which is told if there is one
}
OTHERWISE: dict[str, object] = {
    "world": "forest",
    "world_file_name": "forest.world",
    "home_position": [1.0, 2.0, 3.0],
    "speed": 2,
    "commands": [{"mode": 4}],
    "commands_file": "commands.csv",
    "waypoints": [{"x": 1}],
    "params_file": "own.csv",
}


@pytest.mark.parametrize("robot", ROBOT_WORDS)
@pytest.mark.parametrize("plan", PLAN_WORDS)
@pytest.mark.parametrize("place", [place for place in remarks.WORDS if place not in ("", "assertion", "agent")])
def test_every_known_word_is_flown_or_told_or_changes_no_flight(
    place: str, robot: str, plan: str, folder: Path
) -> None:
    if place in (*ROBOT_WORDS, *PLAN_WORDS) and place not in (robot, plan):
        return
    for word in remarks.WORDS[place]:
        named = f"{place}.{word}"
        if named in FLOWN | CHANGES_NO_FLIGHT:
            continue
        document: dict[str, Any] = {robot: {"mission_file": "mission2.plan"}, "simulation": {"wind": {}}, plan: {}}
        assert told(yaml_text.write(document), folder) == []
        part = document
        for key in place.split("."):
            part = part[key]
        part[word] = OTHERWISE.get(word, 3)
        (found,) = told(yaml_text.write(document), folder)
        assert f"`{word if 'wind' in place else named}`" in found


def test_of_endless_unknown_words_some_are_told_and_the_others_counted(folder: Path) -> None:
    found = told(PLAIN + "".join(f"word{number}: 1\n" for number in range(100)), folder)
    assert len(found) == remarks.TOLD_MAX + 1
    assert "80 more" in found[-1]


@pytest.mark.parametrize("wind", [Wind(), Wind(mean_mps=5.1, from_deg=200.7, gust_mps=2.3, gust_period_s=3.0)])
def test_nothing_is_told_of_what_the_farm_writes(wind: Wind, folder: Path) -> None:
    case = parse_case(PLAIN, "case.yaml", folder)
    for source in (case.source, ""):
        scenario = msgspec.structs.replace(case.scenario, wind=wind, time_limit_s=20.25)
        changed: TestCase = msgspec.structs.replace(case, scenario=scenario, source=source)
        found: list[str] = []
        assert read_case(write_case(changed, folder / "out", "again")[0], found.append).scenario == scenario
        assert found == []
