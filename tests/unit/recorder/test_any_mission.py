"""A find with any mission that an autopilot here flies is recorded, drawn, told, scored and exported."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from test_mcap import START_UNIX_S, record_work

from saflite.console.view.report import layout
from saflite.contract.errors import Refused
from saflite.contract.test_case import Mission, MissionItem, TestCase
from saflite.flight.autopilots.reference.mission_items import KINDS, SKIPPED
from saflite.flight.geometry import COMPETITION_AREA
from saflite.flight.mission import builtin_mission, places_of, waypoints
from saflite.flight.passing import passing_of
from saflite.mutator.operators import boxes
from saflite.recorder import mcap
from saflite.recorder.exports.aerialist import read_case, write_case
from saflite.runtime.clock import WallClock
from saflite.scorer_pool.learning.features import features, path_points
from saflite.scorer_pool.llm.case_text import geometry_text, mission_text
from saflite.scorer_pool.model import Job, Tools
from saflite.scorer_pool.models import low_fidelity

MORE_THAN_PLACES = (17, 18, 84, 85, 177)
COMMANDS = sorted({*KINDS, *SKIPPED, *MORE_THAN_PLACES})


def with_item(command: int) -> Mission:
    mission = builtin_mission("mission2")
    extra = MissionItem(command=command, params=(2.0, 2.0, 0.0, 0.0, 47.3979, 8.5457, 12.0))
    return msgspec.structs.replace(mission, items=(*mission.items[:-1], extra, mission.items[-1]))


def case_with(command: int) -> TestCase:
    case = record_work(1.0)[0].test_case
    return msgspec.structs.replace(case, scenario=msgspec.structs.replace(case.scenario, mission=with_item(command)))


@pytest.mark.parametrize("command", COMMANDS)
def test_what_is_made_of_a_find_takes_any_mission(command: int, tmp_path: Path) -> None:
    work, packed = record_work(10.0)
    case = case_with(command)
    mission = case.scenario.mission
    assert mission is not None
    track = np.column_stack([np.zeros(60), np.linspace(0.0, 50.0, 60), np.full(60, 10.0)])
    assert len(mcap.write(msgspec.structs.replace(work, test_case=case), packed, START_UNIX_S)) > 1_000
    assert "<svg" in layout.picture(case, track)
    assert "start (0, 0)" in mission_text(mission)
    assert geometry_text(case.scenario)
    assert np.isfinite(features([case])).all()
    assert np.isfinite(path_points(mission)).all()
    assert passing_of(case.scenario, track, 20, track[20]).leg >= 1
    assert boxes.places_to_keep_clear(mission)
    assert boxes.legs_in_area(places_of(mission), COMPETITION_AREA)
    assert read_case(write_case(case, tmp_path)[0]).scenario.mission == mission


@pytest.mark.parametrize("command", MORE_THAN_PLACES)
def test_what_is_more_than_a_place_is_not_flown_cheaply(command: int) -> None:
    case = case_with(command)
    assert case.scenario.mission is not None
    with pytest.raises(Refused, match="take-off, way-point, land or return"):
        waypoints(case.scenario.mission)
    model = low_fidelity.Model("", Tools(WallClock(), lambda _: pytest.fail("asked for another model")))
    (score,) = model.score(Job((case,))).scores
    assert score.reason.endswith("not flown")


@pytest.mark.parametrize("name", ["a\0b", "x" * 300, "..", ".bashrc", "\x1b[2Jx", "a/../../b", "", "\n"])
def test_a_mission_of_any_name_is_exported_under_one_that_a_file_can_have(name: str, tmp_path: Path) -> None:
    case = case_with(16)
    mission = msgspec.structs.replace(with_item(16), name=name)
    case = msgspec.structs.replace(case, scenario=msgspec.structs.replace(case.scenario, mission=mission))
    folder = tmp_path / "out"
    written = write_case(case, folder)
    assert {path.parent for path in written} == {folder}
    assert sorted(tmp_path.iterdir()) == [folder]
    assert all(path.name.isprintable() and not path.name.startswith(".") for path in written)
    back = read_case(written[0]).scenario.mission
    assert back is not None
    assert back.items == mission.items
