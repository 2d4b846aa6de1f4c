"""Real logs that others published, from package indexes: at least 25 policies say something where the flight allows.

They are a test, not a sample to fit to: nothing of the reader or of the policies was chosen by what they hold. Those of
PX4 come with the crates `yule_log` and `ulog-rs`, those of ArduCopter with the sources of `signalviewer` and
`mavparser`; a log of one's own is judged beside them when SAFLITE_LOG names it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from real_logs import copter_log, px4_log, whole_copter_log, whole_px4_log

from saflite.console.cli import main

pytestmark = pytest.mark.live

EXPLAINED = ("the log has no ", "no obstacles", "not checked on", "a flight of", "not known all the time: ")


def verdicts(path: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, str]]:
    code = main(["judge", str(path), "--json"])
    assert code in (0, 1, 4)
    found: list[dict[str, str]] = json.loads(capsys.readouterr().out)["verdicts"]
    for verdict in found:
        if verdict["outcome"] == "inconclusive":
            assert verdict["message"].startswith(EXPLAINED)
    return found


@pytest.fixture(scope="module")
def of_px4(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return px4_log(tmp_path_factory.mktemp("crate"))


@pytest.fixture(scope="module")
def of_copter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return copter_log(tmp_path_factory.mktemp("sdist"))


def test_a_px4_log_without_position_is_judged_as_far_as_it_goes(
    of_px4: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = verdicts(of_px4, capsys)
    told = [verdict["policy"] for verdict in found if verdict["outcome"] != "inconclusive"]
    assert "armed-in-flight" in told
    assert len(told) >= 15
    assert any("vehicle_local_position" in verdict["message"] for verdict in found)


def test_a_whole_px4_log_gives_25_verdicts(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    found = verdicts(whole_px4_log(tmp_path_factory.mktemp("whole")), capsys)
    told = {verdict["policy"] for verdict in found if verdict["outcome"] != "inconclusive"}
    assert len(told) >= 25
    assert {verdict["outcome"] for verdict in found if verdict["policy"] in told} <= {"held", "violated", "vacuous"}


def test_an_ardupilot_log_is_judged_by_what_its_messages_and_parameters_tell(
    of_copter: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = verdicts(of_copter, capsys)
    told = {verdict["policy"] for verdict in found if verdict["outcome"] != "inconclusive"}
    assert {"upright", "armed-in-flight"} <= told
    assert any("parameter FENCE_ALT_MAX" in verdict["message"] for verdict in found)


def test_a_whole_ardupilot_log_gives_25_verdicts(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    found = {
        verdict["policy"]: verdict["outcome"]
        for verdict in verdicts(whole_copter_log(tmp_path_factory.mktemp("sdist")), capsys)
    }
    assert len([outcome for outcome in found.values() if outcome != "inconclusive"]) >= 25
    assert {found["upright"], found["angle-max"], found["landed-on-ground"]} == {"held"}
    assert found["no-crash"] == "vacuous"  # its pilot never lets go of the sticks for as long as the rule asks


def test_a_whole_log_of_ones_own_gives_25_verdicts(capsys: pytest.CaptureFixture[str]) -> None:
    path = os.environ.get("SAFLITE_LOG")
    if path is None:
        pytest.skip("SAFLITE_LOG names no log with position, modes and parameters")
    found = verdicts(Path(path), capsys)
    assert len([verdict for verdict in found if verdict["outcome"] != "inconclusive"]) >= 25
