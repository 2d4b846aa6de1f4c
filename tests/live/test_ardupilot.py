"""A real ArduCopter in flight, where `SAFLITE_ARDUPILOT` names one."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from external_flights import answers, case, needs_binary, really_flown
from msgspec.structs import replace

from saflite.contract.signals import MODES
from saflite.contract.standalone import Evidence
from saflite.contract.test_case import Obstacle, Scenario, StartState, Stimulus
from saflite.flight.autopilots.ardupilot.adapter import ADAPTER
from saflite.flight.mission import builtin_mission
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.targets import ardupilot

pytestmark = pytest.mark.live


def test_it_hovers_changes_modes_and_repeats() -> None:
    hover = Scenario(start=StartState(altitude_m=20.0), time_limit_s=20.0)
    one = case("ardupilot", (2.0, "mode", "LOITER", 0.0), (5.0, "parameter", "RTL_ALT", 3000.0), scenario=hover)
    other = case("ardupilot", (1.0, "sensor_fault", "SIM_GPS_DISABLE", 1.0), scenario=hover)
    first, _, again = really_flown(ADAPTER, one, other, one)
    assert first.ending == "completed"
    assert answers(first) == ["accepted", "accepted"]
    assert first.trace is not None
    assert np.abs(first.trace.array("altitude_m") - 20.0).max() < 1.0
    assert list(differences(first, again)) == []


def test_it_flies_on_its_own_physics_and_repeats() -> None:
    hover = Scenario(start=StartState(altitude_m=20.0), time_limit_s=20.0)
    one = case("ardupilot", (2.0, "mode", "LOITER", 0.0), (5.0, "parameter", "RTL_ALT", 3000.0), scenario=hover)
    fall = case("ardupilot", (1.0, "command", "MAV_CMD_DO_FLIGHTTERMINATION", 1.0), scenario=hover)
    cases = [replace(each, target=replace(each.target, settings={"physics": "native"})) for each in (one, fall, one)]
    first, fallen, again = really_flown(ADAPTER, *cases)
    assert first.ending == "completed"
    assert answers(first) == ["accepted", "accepted"]
    assert first.trace is not None
    assert np.abs(first.trace.array("altitude_m") - 20.0).max() < 1.0
    assert list(differences(first, again)) == []
    assert fallen.ending == "crashed"


def test_it_goes_to_a_place_and_moves_home() -> None:
    """The height of home counts from where home was, as on other targets: the vehicle's own height stays."""
    hover = Scenario(start=StartState(mode="GUIDED", altitude_m=20.0), time_limit_s=20.0)
    place = (47.3982, 8.5455938)
    stimuli = (
        Stimulus(at_s=1.0, kind="command", name="MAV_CMD_DO_SET_HOME", values=(0.0, 0.0, 0.0, 0.0, *place, 0.0)),
        Stimulus(at_s=2.0, kind="command", name="MAV_CMD_DO_REPOSITION", values=(-1.0, 0.0, 0.0, 0.0, *place, 25.0)),
    )
    (record,) = really_flown(ADAPTER, replace(case("ardupilot", scenario=hover), stimuli=stimuli))
    assert answers(record) == ["accepted", "accepted"]
    assert record.trace is not None
    assert record.trace.array("x_m")[-1] == pytest.approx(51.0, abs=2.0)
    assert record.trace.array("altitude_m")[-1] == pytest.approx(25.0, abs=1.0)


def test_it_flies_a_mission_round_a_box() -> None:
    box = Obstacle(length_m=6, width_m=6, height_m=25, x_m=20, y_m=30)
    scenario = Scenario(mission=builtin_mission("mission2"), obstacles=(box,), time_limit_s=300.0)
    (record,) = really_flown(ADAPTER, case("ardupilot", scenario=scenario))
    assert record.ending == "completed"
    assert record.trace is not None
    assert record.trace.array("contact").max() == 0.0


@pytest.mark.parametrize("mode", ["BRAKE", "RTL"])
def test_it_begins_on_the_ground_in_a_mode_in_which_nobody_may_arm(mode: str) -> None:
    needs_binary(ADAPTER)
    ground = Scenario(start=StartState(mode=mode, altitude_m=0.0), time_limit_s=6.0)
    (record,) = really_flown(ADAPTER, case("ardupilot", scenario=ground))
    assert record.ending in ("completed", "timed_out")
    assert record.trace is not None
    assert record.trace.array("mode")[0] == MODES[mode]
    assert record.trace.array("armed")[0] == 1.0


def test_parameters_of_groups_that_are_off_are_known() -> None:
    needs_binary(ADAPTER)
    found = {one.name: one.default for one in ardupilot.describe().inputs}
    assert found["CHUTE_ENABLED"] == 0.0
    assert {"CHUTE_ALT_MIN", "BATT_LOW_VOLT", "BATT_FS_LOW_ACT"} <= found.keys()


def test_it_flies_a_finding_without_the_farm(tmp_path: Path) -> None:
    script = _exported(tmp_path) / "finding.py"
    program, out = ADAPTER.binaries.named().path, tmp_path / "out"
    words = [sys.executable, str(script), str(program), "--folder", str(out), "--speedup", "20"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300.0, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (log,) = (out / "logs").glob("*.BIN")
    assert log.stat().st_size > 100_000
    rows = list(csv.DictReader((out / "track.csv").open()))
    assert {row["mode"] for row in rows} == {"4", "5"}
    assert abs(float(rows[-1]["altitude_m"]) - 5.0) < 1.0


def test_a_finding_flies_as_a_case_of_their_autotest(tmp_path: Path) -> None:
    tree = os.environ.get("ARDUPILOT", "")
    if not (Path(tree) / "Tools/autotest/arducopter.py").is_file() or not tree:
        pytest.skip("ARDUPILOT names no source tree")
    script = _exported(tmp_path) / "finding-autotest.py"
    python = os.environ.get("ARDUPILOT_PYTHON", sys.executable)  # one that has what their autotest needs
    theirs = {**os.environ, "PYTHONPATH": f"{tree}/Tools/autotest"}
    words = [python, str(script), str(ADAPTER.binaries.named().path)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600.0, check=False, env=theirs)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    assert "given: parameter RTL_ALT [900.0]" in done.stdout
    assert 'PASSED: "SafliteFinding' in done.stdout


def _exported(folder: Path) -> Path:
    """Fly two harmless inputs and write what maintainers would be given of them; returns the folder."""
    given = case("ardupilot", (1.0, "mode", "LOITER", 0.0), (3.0, "parameter", "RTL_ALT", 900.0), RTL_ALT=1200.0)
    evidence = Evidence("finding.py", "a-loiter1", "LOITER holds", 1.0, 2.0, {}, [])
    (record,) = really_flown(ADAPTER, given)
    for name, text in ardupilot.standalone(given, cast(Any, record), evidence).items():
        (folder / name).write_text(text)
    return folder
