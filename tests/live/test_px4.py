"""A real PX4 in flight, where `SAFLITE_PX4` names one: `bin/px4` in its build folder."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest
from external_flights import answers, case, needs_binary, really_flown

from saflite.contract.rng import derive
from saflite.contract.standalone import Evidence
from saflite.contract.test_case import Obstacle, Scenario, StartState, TestCase
from saflite.flight.autopilots.px4.adapter import ADAPTER
from saflite.flight.mission import builtin_mission
from saflite.mutator.exposure.scenarios import LEGS, scenarios_of
from saflite.simulator_worker.targets import px4

pytestmark = pytest.mark.live
HOVER = Scenario(start=StartState(mode="LOITER", altitude_m=20.0), time_limit_s=20.0)


def test_it_hovers_and_changes_modes() -> None:
    one = case("px4", (2.0, "mode", "ALT_HOLD", 0.0), (5.0, "parameter", "RTL_RETURN_ALT", 30.0), scenario=HOVER)
    (record,) = really_flown(ADAPTER, one)
    assert record.ending == "completed"
    assert answers(record) == ["accepted", "accepted"]
    assert record.trace is not None
    assert np.abs(record.trace.array("altitude_m") - 20.0).max() < 3.0
    assert record.trace.array("rtl_altitude_set_m")[-1] == 30.0
    assert set(record.trace.array("mode")) == {2.0, 5.0}
    changed_s = float(np.argmax(record.trace.array("mode") == 2.0)) * record.trace.step_s
    assert 2.0 < changed_s < 2.3  # a heartbeat, once a second, would tell too late for rules


def test_it_sees_faults() -> None:
    names = ("gps_off", "radio_loss")
    lost, silent = (case("px4", (2.0, "sensor_fault", name, 1.0), scenario=HOVER) for name in names)
    blind, deaf = really_flown(ADAPTER, lost, silent)
    assert answers(blind) == ["accepted"]
    assert blind.trace is not None
    assert deaf.trace is not None
    assert blind.trace.array("gps_ok")[-1] == 0.0
    assert set(blind.trace.array("mode")) != {5.0}
    assert deaf.trace.array("mode")[-1] in (6.0, 9.0)  # returns, then lands


def with_settings(given: TestCase, **settings: str) -> TestCase:
    """Return a test case with settings of the target's own."""
    return msgspec.structs.replace(given, target=msgspec.structs.replace(given.target, settings=dict(settings)))


@pytest.mark.parametrize(("who", "mode"), [("planner", 4.0), ("pilot", 5.0)])  # offboard; position mode
@pytest.mark.parametrize("physics", ["jsbsim", "sih"])
def test_who_flies_beside_it_comes_round_a_box(who: str, mode: float, physics: str) -> None:
    """Our planner sees the box; for a pilot who does not PX4's collision prevention must hold."""
    box = Obstacle(length_m=8, width_m=6, height_m=25, x_m=-3, y_m=30)
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=(box,), time_limit_s=60.0)
    (record,) = really_flown(ADAPTER, with_settings(case("px4", scenario=scenario), companion=who, physics=physics))
    assert record.trace is not None
    assert record.trace.array("obstacle_distance_m").min() > 0.5
    assert record.trace.array("y_m").max() > 34.0  # past the box, which stands across the leg
    assert mode in record.trace.array("mode")


def test_it_flies_on_its_own_physics_and_crashes_there() -> None:
    hover = case("px4", (2.0, "mode", "ALT_HOLD", 0.0), (3.0, "sensor_fault", "gps_satellites", 3.0), scenario=HOVER)
    fall = case("px4", (2.0, "mode", "STABILIZE", 0.0), (3.0, "stick", "RC3", 1000.0), scenario=HOVER)
    held, fallen = really_flown(ADAPTER, *(with_settings(one, physics="sih") for one in (hover, fall)))
    assert held.ending == "completed"
    assert answers(held) == ["accepted", "accepted"]
    assert held.trace is not None
    assert np.abs(held.trace.array("altitude_m") - 20.0).max() < 3.0
    assert (held.trace.array("gps_ok")[0], held.trace.array("gps_ok")[-1]) == (1.0, 0.0)
    assert fallen.ending == "crashed"


def test_it_flies_a_mission() -> None:
    box = Obstacle(length_m=6, width_m=6, height_m=25, x_m=200, y_m=300)
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=(box,), time_limit_s=300.0)
    (record,) = really_flown(ADAPTER, case("px4", scenario=scenario))
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.array("mission_item").max() >= 2.0


@pytest.mark.parametrize("mode", ["RTL", "LAND", "ALT_HOLD"])
def test_it_starts_armed_on_the_ground_in_any_mode(mode: str) -> None:
    ground = Scenario(start=StartState(mode=mode, altitude_m=0.0), time_limit_s=5.0)
    (record,) = really_flown(ADAPTER, case("px4", scenario=ground))
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.array("armed")[0] == 1.0


def test_it_takes_and_starts_missions_as_they_are_drawn() -> None:
    needs_binary(ADAPTER)
    info = px4.describe()
    drawn, items = scenarios_of(Scenario(time_limit_s=1.0), info), set[int]()
    missions: list[Scenario] = []
    for number in range(100):
        one = drawn.mission(derive(number, "missions"))
        assert one.mission is not None
        fresh = {item.command for item in one.mission.items} - items
        items |= fresh
        missions += [msgspec.structs.replace(one, time_limit_s=1.0)] if fresh else []
    assert items >= LEGS.keys() - set(info.mission_lacks)
    flown = really_flown(ADAPTER, *(case("px4", scenario=one) for one in missions))
    assert [record.ending for record in flown] == ["timed_out"] * len(missions)


@pytest.mark.parametrize("mission", [False, True])
def test_a_finding_flies_without_the_farm(tmp_path: Path, mission: bool) -> None:
    needs_binary(ADAPTER)
    plan = Scenario(mission=builtin_mission("mission2"), time_limit_s=40.0)
    scenario = plan if mission else HOVER
    given = case("px4", (1.0, "mode", "ALT_HOLD", 0.0), (3.0, "parameter", "RTL_RETURN_ALT", 30.0), scenario=scenario)
    evidence = Evidence("finding.py", "px-hold1", "HOLD holds", 1.0, 2.0, {}, [])
    flight = cast(Any, SimpleNamespace(ending="completed"))
    for name, text in px4.standalone(given, flight, evidence).items():
        (tmp_path / name).write_text(text)
    out = tmp_path / "out"
    words = [sys.executable, str(tmp_path / "finding.py"), str(ADAPTER.binaries.named().path), "--folder", str(out)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    (log,) = out.rglob("*.ulg")
    assert log.stat().st_size > 100_000
    rows = list(csv.DictReader((out / "track.csv").open()))
    assert "2.0" in {row["mode"] for row in rows}  # PX4_CUSTOM_MAIN_MODE_ALTCTL
    if not mission:
        assert abs(float(rows[0]["altitude_m"]) - 20.0) < 1.5
    assert (tmp_path / "finding.plan").is_file() == mission
