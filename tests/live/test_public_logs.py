"""Real logs that others published, from package indexes: at least 25 policies say something where the flight allows.

They are a test, not a sample to fit to: nothing of the reader or of the policies was chosen by what they hold. The PX4
one comes with the crate `yule_log`, the ArduCopter one with the source of `signalviewer`; a log of one's own is judged
beside them when SAFLITE_LOG names it.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from saflite.console.cli import main

pytestmark = pytest.mark.live
CARGO = '[package]\nname = "logs"\nversion = "0.1.0"\n[lib]\npath = "lib.rs"\n[dependencies]\nyule_log = "=0.4.0"\n'


def verdicts(path: Path, capsys: pytest.CaptureFixture[str]) -> list[dict[str, str]]:
    code = main(["judge", str(path), "--json"])
    assert code in (0, 1, 4)
    found: list[dict[str, str]] = json.loads(capsys.readouterr().out)["verdicts"]
    for verdict in found:
        if verdict["outcome"] == "inconclusive":
            assert verdict["message"].startswith(("the log has no ", "no obstacles", "not checked on", "a flight of"))
    return found


@pytest.fixture(scope="module")
def px4_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight of a VTOL without position, 7 s, armed."""
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    folder = tmp_path_factory.mktemp("crate")
    (folder / "Cargo.toml").write_text(CARGO)
    (folder / "lib.rs").touch()
    home = folder / "home"
    done = subprocess.run(["cargo", "fetch"], cwd=folder, env={**os.environ, "CARGO_HOME": str(home)}, check=False)
    if done.returncode:
        pytest.skip("the package index does not answer")
    return next(home.rglob("data/sample_log_small.ulg"))


@pytest.fixture(scope="module")
def copter_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mission of a copter with few parameters, without an estimate of the place."""
    folder = tmp_path_factory.mktemp("sdist")
    words = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--no-binary", "signalviewer"]
    done = subprocess.run([*words, "-d", str(folder), "signalviewer==1.14.0"], check=False)
    if done.returncode:
        pytest.skip("the package index does not answer")
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        member = next(name for name in archive.getnames() if name.endswith("copter_flight.bin"))
        archive.extract(member, folder, filter="data")
    return folder / member


def test_a_px4_log_without_position_is_judged_as_far_as_it_goes(
    px4_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = verdicts(px4_log, capsys)
    told = [verdict["policy"] for verdict in found if verdict["outcome"] != "inconclusive"]
    assert "armed-in-flight" in told
    assert len(told) >= 15
    assert any("vehicle_local_position" in verdict["message"] for verdict in found)


def test_an_ardupilot_log_is_judged_by_what_its_messages_and_parameters_tell(
    copter_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = verdicts(copter_log, capsys)
    told = {verdict["policy"] for verdict in found if verdict["outcome"] != "inconclusive"}
    assert {"upright", "armed-in-flight"} <= told
    assert any("parameter FENCE_ALT_MAX" in verdict["message"] for verdict in found)


def test_a_whole_log_of_ones_own_gives_25_verdicts(capsys: pytest.CaptureFixture[str]) -> None:
    path = os.environ.get("SAFLITE_LOG")
    if path is None:
        pytest.skip("SAFLITE_LOG names no log with position, modes and parameters")
    found = verdicts(Path(path), capsys)
    assert len([verdict for verdict in found if verdict["outcome"] != "inconclusive"]) >= 25
