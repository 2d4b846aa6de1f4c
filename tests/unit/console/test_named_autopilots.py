"""What a person is told who names a real autopilot's binary, or forgets to."""

from __future__ import annotations

import platform
import struct
import threading
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.console.doctor import checks
from saflite.flight.autopilots.external.elf import MACHINES
from saflite.simulator_worker import registry
from saflite.simulator_worker.targets import reference

VARIABLES = "SAFLITE_ARDUPILOT", "SAFLITE_PX4"


@pytest.fixture(autouse=True)
def _none_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SAFLITE_CACHE", str(tmp_path / "cache"))
    for name in VARIABLES:
        monkeypatch.setenv(name, "")  # set, so that what a command sets goes with the test


@pytest.fixture
def broken(tmp_path: Path) -> Path:
    """Return a program that looks like ArduCopter and does not start."""
    number = {name: number for number, name in MACHINES.items()}[platform.machine()]
    head = b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HH", 2, number) + bytes(44)
    path = tmp_path / "my copter"
    path.write_bytes(head + b"\0ArduCopter V4.5.7\0JSON control interface set to\0")
    path.chmod(0o755)
    return path


def test_a_build_folder_is_led_to_its_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "px4").write_bytes(b"any")
    assert main(["doctor", "--autopilot", str(tmp_path)]) == 2
    either = "name a simulator build: ArduCopter's (SITL), or bin/px4 of PX4's"
    assert f"got a folder; did you mean {tmp_path}/bin/px4?; {either}" in capsys.readouterr().err


def test_advice_for_a_path_with_blanks_can_be_pasted(
    broken: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)  # root may run all
    assert main(["doctor", "--autopilot", str(broken)]) == 2
    assert capsys.readouterr().err.strip().endswith(f"chmod +x '{broken}'")


@pytest.mark.parametrize(("campaign", "label"), [("px4-policies", "PX4"), ("ardupilot-policies", "ArduPilot")])
def test_a_campaign_without_its_binary_says_so_first(
    campaign: str, label: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", campaign, "--budget", "2"]) == 3
    said = capsys.readouterr().err
    assert said.startswith(f"saflite: unavailable: no {label} binary is named; name its simulator build: --autopilot")
    assert said.count("\n") == 1


def test_a_campaign_with_the_binary_of_another_target_says_so(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "px4-policies", "--budget", "2", "--autopilot", str(broken)]) == 3
    assert "no PX4 binary is named, only ArduPilot's; name" in capsys.readouterr().err


def test_a_named_binary_that_does_not_start_is_bad_for_the_doctor(
    broken: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert checks._ardupilot_parameters().state == "note"
    monkeypatch.setenv("SAFLITE_ARDUPILOT", str(broken))
    found = checks._ardupilot_parameters()
    assert found.state == "bad"
    assert "not tried" not in found.text


def test_a_target_of_ours_may_take_its_time_to_start_a_binary(monkeypatch: pytest.MonkeyPatch) -> None:
    known = reference.describe()

    def slow() -> object:
        threading.Event().wait(0.1)
        return known

    monkeypatch.setattr(registry, "DESCRIBE_S", 0.02)
    monkeypatch.setattr(reference, "describe", slow)
    assert registry.describe_target("reference") == known
