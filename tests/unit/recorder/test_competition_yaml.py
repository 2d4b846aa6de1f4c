"""The competition's YAML: both spellings, without loss, faults named with their line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from saflite.contract.errors import Refused
from saflite.contract.test_case import (
    Obstacle,
    Origin,
    Scenario,
    StartState,
    Stimulus,
    Target,
    TestCase,
    Wind,
    identity,
)
from saflite.flight.competition import document as competition
from saflite.flight.competition import yaml_text
from saflite.flight.mission import builtin_mission, dump_plan
from saflite.recorder.exports.aerialist import parse_case, read_case, write_case

OLD = """\
# as the competition of 2024 writes it
drone:
  port: ros
  params_file: mission-params.csv
  mission_file: mission2.plan
simulation:
  simulator: ros
  speed: 1
  headless: true
  obstacles:
  - size: {l: 10, w: 5, h: 20}
    position: {x: 10, y: 20, z: 0, r: 0}
  - size: {l: 10, w: 5, h: 20}
    position: {x: -10, y: 20, z: 0, r: 30}
test:
  commands_file: mission-commands.csv
agent: {engine: docker, count: 3}
mine: [1, two, {three: 2024-01-02}]
"""

NEW = """\
robot:
  port: 14541
  params: {NAV_ACC_RAD: 0.5, NAV_RCL_ACT: 3}
  mission_file: some/where/mission2.plan
simulation:
  simulator: ros
  timeout: 300
  wind: {velocity_mean: 3, velocity_max: 5, direction: [0, 1, 0]}
  obstacles: [5, 4, 15, 10, 25, 0, 0,  3, 3, 12, -10, 30, 0, 45]
mission:
  commands: [{timestamp: 1, mode: 3, x: 0, y: 0, z: 0.5, r: 0}]
assertion: {variable: trajectory}
"""


BLOWN = NEW + "saflite: {rng_seed: 7, wind: {mean_mps: 4, from_deg: 90, gust_period_s: 3}, time_limit_s: 20.5}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mission2.plan").write_text(dump_plan(builtin_mission("mission2")))
    return tmp_path


def parse(text: str, folder: Path) -> TestCase:
    return parse_case(text, "case.yaml", folder)


def data_of(text: str) -> Any:
    return yaml_text.read(text, "").data


@pytest.mark.parametrize(
    "number", ["1:" * 50_000 + "1", "0x" + "f" * 500, "1" * 500 + ".", "!!int " + "1:" * 500 + "1"]
)
def test_numbers_longer_than_any_are_not_worked_out(number: str) -> None:
    """Whole numbers of base 60 took time with the square of their digits: half a minute for one text."""
    with pytest.raises(Refused, match=r"line 2.*numbers of at most 400 characters"):
        yaml_text.read(f"robot: 1\na: {number}\n", "case.yaml")


def test_the_old_spelling_is_read(folder: Path) -> None:
    case = parse(OLD, folder)
    assert case.scenario.mission == builtin_mission("mission2")
    first, second = case.scenario.obstacles
    assert first == Obstacle(length_m=10.0, width_m=5.0, height_m=20.0, x_m=10.0, y_m=20.0)
    assert (second.x_m, second.rotation_deg) == (-10.0, 30.0)
    assert case.scenario.time_limit_s == 500.0
    assert case.target == Target()


def test_the_new_spelling_and_flat_boxes_are_read(folder: Path) -> None:
    case = parse(NEW, folder)
    assert case.scenario.obstacles == (
        Obstacle(length_m=5.0, width_m=4.0, height_m=15.0, x_m=10.0, y_m=25.0),
        Obstacle(length_m=3.0, width_m=3.0, height_m=12.0, x_m=-10.0, y_m=30.0, rotation_deg=45.0),
    )
    assert case.scenario.time_limit_s == 300.0
    wind = case.scenario.wind
    assert (wind.mean_mps, wind.gust_mps) == (3.0, 2.0)
    assert wind.from_deg == pytest.approx(270.0), "blowing towards the east comes from the west"


@pytest.mark.parametrize(
    ("words", "mean_mps", "from_deg", "gust_mps"),
    [
        ("velocity_mean: 5, direction: [0, -2, 0]", 5.0, 90.0, 0.0),
        ("velocity_mean: 5, velocity_max: 10, direction: [3, 0, 4]", 3.0, 180.0, 3.0),
        ("velocity_mean: 5, direction: [0, 3.0e+300, -4.0e+300]", 3.0, 270.0, 0.0),
        ("velocity_mean: 5, velocity_max: 2, direction: [0, 1, 0]", 2.0, 270.0, 0.0),
        ("velocity_mean: 0, velocity_max: 0, direction: [0, 0, 0]", 0.0, 0.0, 0.0),
    ],
)
def test_a_wind_is_flown_as_gazebo_blows_it_in_the_plane(
    words: str, mean_mps: float, from_deg: float, gust_mps: float, folder: Path
) -> None:
    wind = parse(NEW.replace("velocity_mean: 3, velocity_max: 5, direction: [0, 1, 0]", words), folder).scenario.wind
    assert (wind.mean_mps, wind.from_deg, wind.gust_mps) == pytest.approx((mean_mps, from_deg, gust_mps))


@pytest.mark.parametrize("text", [OLD, NEW])
def test_what_was_read_is_written_without_loss(text: str, folder: Path) -> None:
    case = parse(text, folder)
    document = competition.to_document(case)
    assert document == data_of(text)
    assert list(document) == list(data_of(text))
    written = write_case(case, folder / "out", "again")
    assert read_case(written[0]) == case


def test_a_changed_layout_changes_the_obstacles_only(folder: Path) -> None:
    case = parse(OLD, folder)
    moved = msgspec.structs.replace(case.scenario.obstacles[0], x_m=12.5)
    scenario = msgspec.structs.replace(case.scenario, obstacles=(moved, case.scenario.obstacles[1]))
    changed = msgspec.structs.replace(case, scenario=scenario)
    before, after = data_of(OLD), competition.to_document(changed)
    assert after["simulation"]["obstacles"][0]["position"]["x"] == 12.5
    after["simulation"]["obstacles"] = before["simulation"]["obstacles"]
    assert after == before


boxes = st.builds(
    Obstacle,
    length_m=st.floats(1e-3, 1e6),
    width_m=st.floats(1e-3, 1e6),
    height_m=st.floats(1e-3, 1e6),
    x_m=st.floats(-1e6, 1e6),
    y_m=st.floats(-1e6, 1e6),
    z_m=st.floats(-10, 10),
    rotation_deg=st.floats(-720, 720),
)
stimuli = st.builds(
    Stimulus,
    at_s=st.floats(0, 100),
    kind=st.sampled_from(["parameter", "command", "stick", "mode", "sensor_fault"]),
    name=st.sampled_from(["RTL_ALT", "MAV_CMD_DO_PARACHUTE", "RC3", "FLIP", "no", "1e3", "2024-01-01"]),
    values=st.lists(st.floats(-3.4e38, 3.4e38), max_size=7).map(tuple),
)
cases = st.builds(
    TestCase,
    target=st.builds(
        Target,
        name=st.sampled_from(["reference", "px4"]),
        parameters=st.dictionaries(st.sampled_from(["RTL_ALT", "null", "~"]), st.floats(-1e9, 1e9), max_size=3),
        settings=st.dictionaries(st.sampled_from(["a", "off"]), st.lists(st.sampled_from(["x", "y"]), max_size=2)),
    ),
    scenario=st.builds(
        Scenario,
        mission=st.just(builtin_mission("mission2")),
        start=st.none() | st.builds(StartState, mode=st.sampled_from(["GUIDED", "ACRO"])),
        obstacles=st.lists(boxes, max_size=4).map(tuple),
        wind=st.builds(Wind, mean_mps=st.floats(0, 20), from_deg=st.floats(0, 360), gust_mps=st.floats(0, 9)),
        time_limit_s=st.sampled_from([500.0, 60.0]),
    ),
    stimuli=st.lists(stimuli, max_size=4).map(tuple),
    rng_seed=st.integers(0, 2**62),
)


@given(case=cases, source=st.sampled_from(["", OLD, NEW, NEW + "saflite: {rng_seed: 7}\n", BLOWN]))
def test_every_test_case_survives_the_way_through_yaml(
    case: TestCase, source: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    kept = json.dumps(data_of(source)) if source else ""
    case = msgspec.structs.replace(case, source=kept)
    text = yaml_text.write(competition.to_document(case))
    back = competition.to_test_case(yaml_text.read(text, "x"), lambda name, where: builtin_mission("mission2"))
    assert identity(back) == identity(case)
    assert msgspec.structs.replace(back, source="", origin=Origin()) == msgspec.structs.replace(case, source="")
    assert yaml.safe_load(text).keys() >= {"simulation"}


@pytest.mark.parametrize(
    "block", ["{}", "{rng_seed: 7}", "{stimuli: []}", "{heading_deg: 90}", "{wind: null, time_limit_s: null}"]
)
def test_a_block_of_ours_drops_nothing_it_does_not_name(block: str, folder: Path) -> None:
    plain, beside = parse(NEW, folder).scenario, parse(f"{NEW}saflite: {block}\n", folder).scenario
    assert plain.wind.mean_mps == 3.0
    assert (beside.wind, beside.time_limit_s) == (plain.wind, plain.time_limit_s)


def test_a_block_of_ours_goes_before_the_words_of_the_document(folder: Path) -> None:
    of_block = parse(NEW + "saflite: {wind: {mean_mps: 4}}\n", folder).scenario
    assert (of_block.wind, of_block.time_limit_s) == (Wind(mean_mps=4.0), 300.0)
    of_block = parse(NEW + "saflite: {time_limit_s: 20}\n", folder).scenario
    assert (of_block.wind, of_block.time_limit_s) == (parse(NEW, folder).scenario.wind, 20.0)


@pytest.mark.parametrize("source", ["", OLD, NEW, BLOWN])
@pytest.mark.parametrize(
    "wind",
    [Wind(), Wind(from_deg=30.0), Wind(mean_mps=5.0, from_deg=200.0, gust_mps=2.0), Wind(mean_mps=-5.0, from_deg=20.0)],
)
def test_aerialist_is_told_the_wind_and_the_limit_that_are_flown(source: str, wind: Wind, folder: Path) -> None:
    case = parse(source or OLD, folder)
    scenario = msgspec.structs.replace(case.scenario, wind=wind, time_limit_s=120.25)
    case = msgspec.structs.replace(case, scenario=scenario, source=case.source if source else "")
    text = yaml_text.write(competition.to_document(case))
    assert parse(text, folder).scenario == scenario
    simulation = data_of(text)["simulation"]
    assert simulation["timeout"] == 121, "Aerialist takes whole seconds"
    if not wind.mean_mps:
        assert "wind" not in simulation
        return
    said = simulation["wind"]
    towards = [
        wind.mean_mps * -turned for turned in (np.cos(np.radians(wind.from_deg)), np.sin(np.radians(wind.from_deg)))
    ]
    assert [said["velocity_mean"] * part for part in said["direction"][:2]] == pytest.approx(towards)
    assert said["velocity_max"] == abs(wind.mean_mps) + wind.gust_mps


def test_our_own_document_holds_what_the_competition_expects(tmp_path: Path) -> None:
    box = Obstacle(length_m=10.0, width_m=5.0, height_m=20.0, x_m=1.0, y_m=20.0, rotation_deg=30.0)
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=(box,))
    yaml_file, plan_file = write_case(TestCase(target=Target(), scenario=scenario, rng_seed=7), tmp_path, "mine")
    data = yaml.safe_load(yaml_file.read_text())
    assert data["robot"]["mission_file"] == plan_file.name == "mission2.plan"
    assert data["robot"]["params"]["NAV_ACC_RAD"] == 0.5
    assert data["simulation"]["obstacles"] == [
        {"size": {"l": 10.0, "w": 5.0, "h": 20.0}, "position": {"x": 1.0, "y": 20.0, "z": 0.0, "r": 30.0}}
    ]
    assert data["mission"]["commands"][0]["mode"] == 3
    assert data["saflite"] == {"rng_seed": 7}


def test_two_missions_of_one_name_are_both_written_and_found_again(tmp_path: Path) -> None:
    mission = builtin_mission("mission2")
    other = msgspec.structs.replace(mission, home_alt_m=1.0)
    cases = [TestCase(target=Target(), scenario=Scenario(mission=each)) for each in (mission, other, mission, other)]
    files = [write_case(case, tmp_path) for case in cases]
    assert files[:2] == files[2:]
    assert len(list(tmp_path.glob("*.plan"))) == 2
    read = [read_case(yaml).scenario.mission for yaml, _ in files]
    assert [each and each.home_alt_m for each in read] == [mission.home_alt_m, 1.0] * 2

    again = msgspec.structs.replace(other, name=mission.name)  # read from a document that names the other file
    case = msgspec.structs.replace(read_case(files[0][0]), scenario=Scenario(mission=again))
    assert read_case(write_case(case, tmp_path, "again")[0]).scenario.mission == read[1]


@pytest.mark.parametrize(
    ("text", "word", "line"),
    [
        ("drone: [\n", "well-formed", 2),
        ("drone:\n  a: 1\n b: 2\n", "well-formed", 3),
        ("- 1\n", "a mapping, got a list", 1),
        ("", "a mapping, got nothing", 1),
        ("1: 2\n", "keys that are words", 1),
        ("robot: {a: 1}\nrobot: {a: 2}\n", "two of it", 2),
        ("a: &x [1]\nb: *x\n", "aliases", 1),
        ("robot: 3\n", "mapping", 1),
        (OLD.replace("mission2.plan", "gone.plan"), "gone.plan", 5),
        (OLD.replace("  mission_file: mission2.plan\n", ""), "mission_file", 3),
        (OLD.replace("x: 10,", "x: ten,"), "finite number", 12),
        (OLD.replace("x: 10,", "x: .inf,"), "finite number", 12),
        (OLD.replace("l: 10, w: 5, h: 20}", "l: 10, w: 5}"), "obstacles.0.size.h", 11),
        (OLD.replace("- size: {l: 10", "- shape: cylinder\n    size: {l: 10"), "box", 11),
        (NEW.replace("0, 45]", "0]"), "l, w, h, x, y, z, r", 9),
        (NEW.replace("timeout: 300", "timeout: soon"), "finite number", 7),
        (NEW.replace("[0, 1, 0]", "[0, 1]"), "3 numbers", 8),
        (NEW.replace("[0, 1, 0]", "[0, 0, 0]"), "in the plane", 8),
        (NEW.replace("[0, 1, 0]", "[0, 0, -1]"), "in the plane", 8),
        (NEW.replace("velocity_mean: 3", "velocity_mean: 0").replace("[0, 1, 0]", "[0, -0.0, 1]"), "in the plane", 8),
        (NEW.replace("velocity_mean: 3", "velocity_mean: -3"), "0 or more", 8),
        (NEW.replace("velocity_max: 5", "velocity_max: -5"), "0 or more", 8),
        (NEW + "saflite: {rng_sed: 3}\n", "rng_sed", 13),
    ],
)
def test_faults_are_refused_with_their_line(text: str, word: str, line: int, folder: Path) -> None:
    with pytest.raises(Refused, match=word) as refusal:
        parse(text, folder)
    assert refusal.value.where == f"case.yaml, line {line}"


@pytest.mark.parametrize(
    "value", ["!!binary", "!!binary aGFsbG8=", "!!set {a}", "!!timestamp 2026-11-27", "!!omap [a: 1]", "!x 1"]
)
def test_what_json_cannot_hold_is_refused_where_it_stands(value: str) -> None:
    with pytest.raises(Refused, match="line 2"):
        yaml_text.read(f"robot:\n  port: {value}\n", "case.yaml")


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        yaml_text.read(text, "any")
    except Refused:
        return


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"none\.yaml"):
        read_case(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    "text", ["a: [" + "1," * 50_000 + "]", "a:\n" + "- 1\n" * 50_000, "a: [" + "{}," * 50_000 + "]"]
)
def test_a_text_of_endless_values_is_refused_before_it_is_read(text: str) -> None:
    with pytest.raises(Refused, match=f"more than {yaml_text.NODES_MAX} values"):
        yaml_text.read(text, "case.yaml")


@pytest.mark.parametrize("text", ["[" * 200, "a: " + "{a: " * 200, "- " * 200, "? " * 200])
def test_a_text_that_nests_without_end_is_refused_where_it_does(text: str) -> None:
    with pytest.raises(Refused, match=r"case\.yaml, line 1.*more than 32 levels of nesting"):
        yaml_text.read(text, "case.yaml")
