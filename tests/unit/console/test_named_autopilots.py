"""What a person is told who names a real autopilot's binary, or forgets to."""

from __future__ import annotations

import platform
import struct
import sys
import threading
from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import main, parser_of
from saflite.console.doctor import checks
from saflite.console.run_data.run_folder import open_run
from saflite.contract.work import FlyResult, Result, Work
from saflite.flight.autopilots.ardupilot import binary as ardupilot
from saflite.flight.autopilots.external.elf import MACHINES
from saflite.simulator_worker import registry
from saflite.simulator_worker.targets import reference

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

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


NONE = "no ArduPilot binary is named; name its simulator build: --autopilot PATH or SAFLITE_ARDUPILOT=PATH"
BUILD = "0123456789abcdef" * 4


class OnBuild(doubles.Service):
    """Flies on one build."""

    def do(self, work: Work) -> Result:
        """Do the work."""
        result = super().do(work)
        if isinstance(result, FlyResult):
            return FlyResult(flight=msgspec.structs.replace(result.flight, build=BUILD))
        return result


@pytest.fixture
def flown(tmp_path: Path) -> Path:
    """Return a run on a build of ArduPilot, with violations, some of which nobody flew again."""
    campaign = load_campaign("avoidance-m2")
    campaign = msgspec.structs.replace(
        campaign, budget_flights=6, target=msgspec.structs.replace(campaign.target, name="ardupilot")
    )
    info = msgspec.structs.replace(reference.describe(), name="ardupilot", build=BUILD)
    store = Store.create(tmp_path / "run", campaign, template(campaign, BUILD), info)
    driver = Driver(store.rebuild(), store)
    driver.service = OnBuild(store.blobs)
    while not driver.books.status(driver.now).violations_pending:
        for stage in ("mutate", "score", "fly", "judge"):
            driver.do(stage)
        driver.now += 0.5
        driver.books.tick(driver.now)
    store.close()
    return tmp_path / "run"


@pytest.mark.parametrize(
    "words", [["replay", "RUN", "--all"], ["resume", "RUN"], ["export", "RUN", "--recording", "CASE"]]
)
def test_what_cannot_be_flown_here_is_told_as_that_once(
    words: list[str], flown: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_run(flown) as run:
        known = {"RUN": str(flown), "CASE": run.flights()[0].test_case}
    assert main([known.get(word, word) for word in words]) == 3
    said = capsys.readouterr()
    assert said.err == f"saflite: unavailable: {NONE}\n"
    assert "DIFFERS" not in said.out


@pytest.mark.parametrize("command", ["fly", "replay"])
def test_so_is_a_test_case(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case = template(load_campaign("avoidance-m2"))
    case = msgspec.structs.replace(case, target=msgspec.structs.replace(case.target, name="ardupilot"))
    path = tmp_path / "case.json"
    path.write_bytes(msgspec.json.encode(case))
    assert main([command, str(path)]) == 3
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", f"saflite: unavailable: {NONE}\n")


def test_proposals_that_need_what_only_the_binary_tells_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["mutate", "ardupilot-policies", "--count", "2"]) == 3
    assert capsys.readouterr().err == f"saflite: unavailable: {NONE}\n"


def test_a_command_that_asks_for_a_binary_takes_one() -> None:
    args = parser_of("export").parse_args(["--standalone", "0123456789abcdef", "--autopilot", "copter"])
    assert args.autopilot == Path("copter")


@pytest.mark.parametrize("words", [["run", "avoidance-m2"], ["run", "policy-upright", "--target", "reference"]])
def test_a_binary_that_would_not_fly_is_refused(
    words: list[str], broken: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = tmp_path / "made"
    assert main([*words, "--budget", "1", "--out", str(made), "--autopilot", str(broken)]) == 2
    said = capsys.readouterr().err
    assert "--autopilot: expected a campaign on ardupilot, which the binary flies for, got one on reference" in said
    assert not made.exists()


def test_a_program_that_is_no_autopilot_is_told_both(broken: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken.write_bytes(broken.read_bytes().replace(b"ArduCopter", b"Anything  "))
    assert main(["doctor", "--autopilot", str(broken)]) == 2
    said = capsys.readouterr().err
    assert "expected ArduCopter or PX4, got a program with neither's words; name a simulator build: Ardu" in said


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


def test_a_program_without_end_is_not_read(
    broken: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of it was read into memory to see whether it is PX4; a sparse file costs who sends it nothing."""
    with broken.open("r+b") as file:
        file.truncate(2**36)
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read"))
    assert main(["doctor", "--autopilot", str(broken)]) == 2
    assert "expected files of at most 1073741824 bytes, got 68719476736 bytes" in capsys.readouterr().err


def test_a_version_without_end_is_told_in_short(broken: Path) -> None:
    content = broken.read_bytes()
    broken.write_bytes(content.replace(b"V4.5.7", b"V4.5.7 " + b"a" * 2**20))
    assert len(ardupilot.BINARIES.inspect(broken).version) < 100
