"""A finding on PX4 as a script: what it holds, what stays at home."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from saflite.contract.errors import Refused
from saflite.contract.standalone import Evidence
from saflite.contract.test_case import (
    Mission,
    MissionItem,
    Obstacle,
    Scenario,
    StartState,
    Stimulus,
    Target,
    TestCase,
)
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.autopilots.px4.standalone.export import files_of
from saflite.flight.mission import builtin_mission, parse_plan

REAL32, INT32 = 9, 6
ROWS = {
    "SIM_BARO_OFF_P": (0.0, REAL32),
    "RTL_RETURN_ALT": (60.0, REAL32),
    "NAV_RCL_ACT": (2.0, INT32),
    "RC_FAILS_THR": (0.0, INT32),
}
LISTING = Listing(binary="0" * 64, parameters={name: Row(*row) for name, row in ROWS.items()})
KNOWN = Binary(Path("/nowhere/px4"), "ab" * 32, "PX4")
TOLD = Evidence("it.py", "px-rtl1", 'RTL "climbs"', 6.0, 8.0, {"ranges": "all inside"}, ["5 s: mode RTL"])
FLIGHT = cast(Any, SimpleNamespace(ending="completed"))


def exported(*stimuli: Stimulus, scenario: Scenario | None = None) -> dict[str, str]:
    """Return the files of a finding made of these inputs."""
    hover = Scenario(start=StartState(mode="GUIDED", altitude_m=20.0), time_limit_s=30.0)
    target = Target(name="px4", parameters={"RTL_RETURN_ALT": 30.0})
    return files_of(TestCase(target=target, scenario=scenario or hover, stimuli=stimuli), FLIGHT, TOLD, KNOWN, LISTING)


def facts(files: dict[str, str]) -> dict[str, Any]:
    """Return what the script is told."""
    read = json.loads(files["it.py"].partition('json.loads(r"""')[2].partition('""")')[0])
    assert isinstance(read, dict)
    return read


def test_a_finding_leaves_as_a_script_that_python_takes() -> None:
    files = exported(
        Stimulus(at_s=5.0, kind="mode", name="RTL"),
        Stimulus(at_s=2.0, kind="parameter", name="NAV_RCL_ACT", values=(3.0,)),
        Stimulus(at_s=6.0, kind="sensor_fault", name="gps_off", values=(1.0,)),
        Stimulus(at_s=7.0, kind="sensor_fault", name="radio_loss", values=(1.0,)),
    )
    assert 'RTL "climbs"' in (ast.get_docstring(ast.parse(files["it.py"])) or "")
    assert "/nowhere" not in files["it.py"]
    found = facts(files)
    assert [one["name"] for one in found["inputs"]] == ["NAV_RCL_ACT", "RTL", "gps_off", "radio_loss"]
    assert found["inputs"][0]["number"] == INT32
    assert found["inputs"][1]["values"] == [1.0, 4.0, 5.0]
    assert found["inputs"][2]["values"] == [4, 1, 0.0]  # FAILURE_UNIT_SENSOR_GPS, FAILURE_TYPE_OFF
    assert found["mode"] == [4, 3]  # GUIDED is OFFBOARD, which needs a companion: HOLD instead
    assert found["parameters"] == {"RTL_RETURN_ALT": "30", "COM_RC_IN_MODE": "1"}
    assert files["it.params"].splitlines()[1:] == ["1\t1\tRTL_RETURN_ALT\t30\t9"]
    assert list(files) == ["it.py", "it.params", "it-steps.txt"]


def test_a_fault_that_its_own_sensors_have_leaves_as_their_parameter() -> None:
    (found,) = facts(exported(Stimulus(at_s=1.0, kind="sensor_fault", name="baro_offset", values=(2.0,))))["inputs"]
    assert (found["kind"], found["name"], found["number"]) == ("parameter", "SIM_BARO_OFF_P", REAL32)
    assert found["values"] == pytest.approx([-22.8])


def test_who_was_flown_by_somebody_else_does_not_leave_as_a_script() -> None:
    target = Target(name="px4", settings={"companion": "planner"})
    flown = TestCase(target=target, scenario=Scenario(mission=builtin_mission("mission2")))
    with pytest.raises(Refused, match="a finding that PX4 flies alone, got a planner"):
        files_of(flown, FLIGHT, TOLD, KNOWN, LISTING)


def test_the_script_of_a_finding_on_its_own_physics_says_so() -> None:
    target = Target(name="px4", settings={"physics": "sih"})
    start = StartState(mode="BRAKE", altitude_m=20.0)
    flown = TestCase(target=target, scenario=Scenario(start=start, time_limit_s=30.0))
    assert "the farm flew it there, too" in files_of(flown, FLIGHT, TOLD, KNOWN, LISTING)["it.py"]


def test_a_mission_leaves_as_a_plan_too() -> None:
    mission = builtin_mission("mission2")
    files = exported(scenario=Scenario(mission=mission))
    assert parse_plan(files["it.plan"], "it.plan", mission.name) == mission
    assert len(facts(files)["items"]) == len(mission.items)


def test_the_script_sends_a_mission_as_the_farm_does() -> None:
    here = MissionItem(command=22, params=(0.0, 0.0, 0.0, 0.0, 47.4, 8.5, 20.0))
    slower, home = MissionItem(command=178, params=(1.0, 2.0, *[0.0] * 5)), MissionItem(command=20, params=(0.0,) * 7)
    mission = Mission(name="m", home_lat_deg=47.4, home_lon_deg=8.5, home_alt_m=0.0, items=(here, slower, home))
    sent = facts(exported(scenario=Scenario(mission=mission)))["items"]
    assert [numbers[0] for numbers in sent] == [3, 2, 2]  # MAV_FRAME_MISSION: at no place


@pytest.mark.parametrize(
    ("stimuli", "boxes"),
    [
        ((), (Obstacle(length_m=5, width_m=5, height_m=20, x_m=20, y_m=0),)),
        ((Stimulus(at_s=1.0, kind="sensor_fault", name="gps_noise", values=(3.0,)),), ()),
    ],
)
def test_what_its_own_physics_does_not_know_is_refused(
    stimuli: tuple[Stimulus, ...], boxes: tuple[Obstacle, ...]
) -> None:
    with pytest.raises(Refused, match="standalone"):
        exported(*stimuli, scenario=Scenario(obstacles=boxes))
