"""Pieces of the ArduPilot adapter that need no autopilot: layouts, what a file is, telemetry, obstacles, checks."""

from __future__ import annotations

import ctypes
import json
import os
import platform
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from external_stand_ins import Deaf, message
from msgspec.structs import replace

from saflite.contract.errors import Refused
from saflite.contract.test_case import MissionItem, Obstacle, Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.autopilots.ardupilot import binary, settings
from saflite.flight.autopilots.ardupilot.bring_up import PORTS_NEEDED, command
from saflite.flight.autopilots.ardupilot.check import check_test_case
from saflite.flight.autopilots.ardupilot.describe import describe
from saflite.flight.autopilots.ardupilot.inputs import COMMANDS, MODE_NUMBERS
from saflite.flight.autopilots.ardupilot.metadata import documented
from saflite.flight.autopilots.ardupilot.mission import as_taken
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.external import obstacles
from saflite.flight.autopilots.external.elf import MACHINES
from saflite.flight.autopilots.external.flight import _flown_items
from saflite.flight.autopilots.external.inputs import Inputs, command_numbers
from saflite.flight.autopilots.external.link import SimulatedClock
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.autopilots.external.process import last_line
from saflite.flight.geometry import boxes_array
from saflite.flight.mavlink.client import Client
from saflite.flight.mission import builtin_mission
from saflite.flight.native_library import python_library
from saflite.simulator_worker.agreement import own_contradictions

HOME = (47.3977419, 8.5455938, 488.79)
REAL32, INT16 = 9, 4
LISTING = Listing(
    binary="0" * 64,
    parameters={
        "RTL_ALT": Row(1500.0, INT16),
        "FENCE_ENABLE": Row(0.0, INT16),
        "FENCE_TYPE": Row(7.0, INT16),
        "ATC_RAT_RLL_P": Row(0.135, REAL32),
        "SIM_WIND_SPD": Row(0.0, REAL32),
        "SIM_GPS_GLITCH_X": Row(0.0, REAL32),
        "PRX1_TYPE": Row(0.0, INT16),
    },
)


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle(np.zeros((0, 8)), 0.0)


# ---- the JSON backend ---------------------------------------------------------------------------------------------


def servo(magic: int, channels: int, *pulses: int) -> bytes:
    every = [*pulses, *([1000] * channels)][:channels]
    return struct.pack(f"<HHI{channels}H", magic, 400, 7, *every)


@pytest.mark.parametrize(("magic", "channels"), [(18458, 16), (29569, 32)])
def test_servo_packets_give_throttles(magic: int, channels: int) -> None:
    frame, throttles = ctypes.c_uint32(), (ctypes.c_double * 4)()
    data = servo(magic, channels, 1000, 1250, 2000, 2300)
    assert python_library().servo_packet(data, len(data), ctypes.byref(frame), throttles) == 1
    assert frame.value == 7
    assert list(throttles) == [0.0, 0.25, 1.0, 1.0]


@pytest.mark.parametrize("data", [b"", servo(18458, 32), servo(29569, 16), servo(18459, 16), servo(18458, 16)[:-1]])
def test_other_packets_are_none(data: bytes) -> None:
    frame, throttles = ctypes.c_uint32(), (ctypes.c_double * 4)()
    assert python_library().servo_packet(data, len(data), ctypes.byref(frame), throttles) == 0


def test_every_setting_shown_has_its_place_in_the_trace() -> None:
    assert set(settings.SHOWN) <= set(Vehicle.slots())


def test_the_state_is_a_line_of_json_without_blanks_and_time_is_stretched(vehicle: Vehicle) -> None:
    vehicle.set(step=400.0, altitude_m=12.5, climb_mps=1.5, x_m=3.0, yaw_rad=0.5, force_z_mps2=-9.81)
    into = ctypes.create_string_buffer(640)
    python_library().state_line.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int]
    count = python_library().state_line(vehicle.address, into, 640)
    line = into.raw[:count].decode()
    assert line.startswith("\n")
    assert line.endswith("}\n")
    assert " " not in line  # the backend reads vectors right behind the colon
    told = json.loads(line)
    assert told["position"] == pytest.approx([3.0, 0.0, -12.5], abs=1e-9)
    assert told["velocity"][2] == -1.5
    assert told["attitude"][2] == 0.5
    assert told["imu"]["accel_body"][2] == -9.81
    # whole microseconds are cut off each step: exact steps would lose one each
    assert int((told["timestamp"] - 399 * 0.0025 * (1 + 4e-8)) * 1e6) == 2500


# ---- the binary ---------------------------------------------------------------------------------------------------

NUMBER = {name: number for number, name in MACHINES.items()}[platform.machine()]
BACKEND = b"JSON control interface set to %s"


def program(path: Path, *words: bytes, machine: int = NUMBER, mode: int = 0o755) -> Path:
    head = b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HH", 2, machine)
    path.write_bytes(head + bytes(44) + b"\0".join((b"", *words, b"")))
    path.chmod(mode)
    return path


def test_a_binary_is_known_by_its_content(tmp_path: Path) -> None:
    first = binary.BINARIES.inspect(program(tmp_path / "one", b"ArduCopter V4.5.7", BACKEND))
    again = binary.BINARIES.inspect(program(tmp_path / "two", b"ArduCopter V4.5.7", BACKEND))
    assert first.version == "ArduCopter V4.5.7"
    assert first.digest == again.digest


def test_a_binary_that_is_replaced_is_told_apart_though_its_time_is_the_same(tmp_path: Path) -> None:
    path = program(tmp_path / "arducopter", b"ArduCopter V4.5.7", BACKEND)
    first, before = binary.BINARIES.inspect(path), path.stat()
    binary.BINARIES.check_same(first)
    rebuilt = program(tmp_path / "new", b"ArduCopter V4.5.7", BACKEND, b"mended")
    os.utime(rebuilt, ns=(before.st_atime_ns, before.st_mtime_ns))
    rebuilt.replace(path)
    second = binary.BINARIES.inspect(path)
    assert second.digest != first.digest
    told = f"expected the one that this session began with, SHA-256 {first.digest[:12]}, got another in its place"
    with pytest.raises(Refused, match=told):
        binary.BINARIES.check_same(first)
    path.unlink()
    with pytest.raises(Refused, match="nothing there"):
        binary.BINARIES.check_same(first)


def test_a_binary_that_was_only_copied_over_itself_is_the_same(tmp_path: Path) -> None:
    path = program(tmp_path / "arducopter", b"ArduCopter V4.5.7", BACKEND)
    first = binary.BINARIES.inspect(path)
    program(tmp_path / "again", b"ArduCopter V4.5.7", BACKEND).replace(path)
    binary.BINARIES.check_same(first)


@pytest.mark.parametrize(
    ("words", "options", "said"),
    [
        ((b"ArduPlane V4.5.7", BACKEND), {}, "expected ArduCopter: the world is a quadrotor, got ArduPlane V4.5.7"),
        ((b"ArduCopter V4.5.7",), {}, "expected a build for the simulator with its JSON backend"),
        ((b"hello",), {}, "got a program without ArduPilot's version"),
        ((b"px4_daemon",), {}, "got a PX4 binary"),
        ((b"ArduCopter V4.5.7", BACKEND), {"machine": 9999}, "got one for processor 9999"),
        ((b"ArduCopter V4.5.7", BACKEND), {"mode": 0o644}, "expected leave to run it"),
    ],
)
def test_what_cannot_fly_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[bytes, ...], options: dict[str, int], said: str
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: path.stat().st_mode & 0o100 != 0)  # root may run all
    with pytest.raises(Refused, match="autopilot") as caught:
        binary.BINARIES.inspect(program(tmp_path / "x", *words, **options))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_file_and_no_program_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("#!/bin/sh\n")
    (tmp_path / "empty").write_text("")
    build = tmp_path / "a build"
    (build / "bin").mkdir(parents=True)
    program(build / "bin" / "px4", b"px4_daemon")
    said = {
        tmp_path / "nothing": "got nothing there; name",
        tmp_path / "text": "got another kind of file; name",
        tmp_path / "text" / "below": "got nothing there; name",
        tmp_path / "empty": "got an empty file; name",
        tmp_path: "got a folder; name",
        build: f"got a folder; did you mean '{build}/bin/px4'?; name",
        Path("/dev/null"): "got something else than a file; name",
    }
    for path, words in said.items():
        with pytest.raises(Refused, match="a program") as caught:
            binary.BINARIES.inspect(path)
        assert words in str(caught.value)


def test_a_build_of_2020_is_started_by_the_options_that_it_had(tmp_path: Path) -> None:
    told = b"\xffArduCopter V4.1.0-dev (ffccc8bb)"  # no NUL before it there
    found = binary.BINARIES.inspect(program(tmp_path / "arducopter", told, BACKEND, b"\t--uartA device"))
    assert found.version == "ArduCopter V4.1.0-dev"
    words = command(found, range(21_000, 21_020), HOME, 90.0)
    assert words[words.index("--uartA") + 1] == "tcp:0:wait"
    assert not {"--serial0", "--start-time"} & set(words)


def test_the_command_line_uses_the_slots_ports_only(tmp_path: Path) -> None:
    build = program(tmp_path / "arducopter", b"ArduCopter V4.5.7", BACKEND, b"--serial0", b"--start-time")
    words = command(binary.BINARIES.inspect(build), range(21_000, 21_020), HOME, 90.0)
    assert "--serial0" in words
    assert "--start-time" in words
    ports = [int(words[i + 1]) for i, word in enumerate(words) if word.endswith(("-port", "-port-in", "-port-out"))]
    assert len(ports) == 5
    assert len(set(ports)) == 5
    assert all(21_000 <= port < 21_000 + PORTS_NEEDED for port in ports)


def test_a_mission_is_done_at_the_last_item_that_flies_somewhere() -> None:
    """ArduCopter hovers there; what only waits or does something after it is never told as the current item."""
    waypoint, heading, speed, jump = (MissionItem(command=number) for number in (16, 115, 178, 177))
    flown = (
        ((), 0),
        ((waypoint,), 1),
        ((waypoint, speed, waypoint), 3),
        ((waypoint, waypoint, heading, speed, jump), 2),
    )
    for items, count in flown:
        assert _flown_items(replace(builtin_mission("mission2"), items=items)) == count


def test_deaths_are_told_without_addresses() -> None:
    console = "Setting up\r\nPANIC: bad thing at 0x55aa12\nbacktrace 1\nbacktrace 2\n"
    assert last_line(console) == "PANIC: bad thing at 0x.."
    assert last_line("one\ntwo\n") == "two"
    assert last_line("\x1b[31mERROR [px4] no script\x1b[0m\n") == "ERROR [px4] no script"
    assert last_line("") == "it said nothing"


# ---- parameters ---------------------------------------------------------------------------------------------------


def test_the_vehicle_starts_with_our_tune_what_is_given_and_only_what_it_knows() -> None:
    plain = settings.start_parameters({"RTL_ALT": 3000.0}, LISTING.parameters, obstacles=False)
    assert plain == {"ATC_RAT_RLL_P": 0.09, "RTL_ALT": 3000.0}
    assert settings.start_parameters({}, LISTING.parameters, obstacles=True)["PRX1_TYPE"] == 2.0
    assert settings.as_file(plain) == "ATC_RAT_RLL_P 0.09\nRTL_ALT 3000\n"


def test_settings_in_force_are_shown_in_si_units(vehicle: Vehicle) -> None:
    settings.show(vehicle, {"RTL_ALT": 3000.0, "EK3_SRC1_POSZ": 3.0, "PILOT_SPEED_UP": 250.0, "PILOT_SPEED_DN": 0.0})
    assert vehicle["rtl_altitude_set_m"] == 30.0
    assert vehicle["altitude_source"] == 2.0
    assert vehicle["pilot_speed_down_set_mps"] == 2.5  # 0: as fast as up


def test_metadata_beside_the_binary_gives_ranges(tmp_path: Path) -> None:
    row = {"Range": {"low": "30", "high": "300000"}, "Units": "cm", "DisplayName": "RTL Altitude"}
    choice = {"Values": {"0": "Disabled", "1": "Enabled"}, "DisplayName": "Fence"}
    pages = {"json": {"version": 0}, "RTL": {"RTL_ALT": row}, "FENCE_": {"FENCE_ENABLE": choice}}
    (tmp_path / "apm.pdef.json").write_text(json.dumps(pages))
    told = documented(tmp_path / "arducopter")
    assert told["RTL_ALT"][:3] == (30.0, 300_000.0, "cm")
    assert told["FENCE_ENABLE"].choices == (0.0, 1.0)
    assert documented(tmp_path / "elsewhere" / "arducopter") == {}


def test_searches_leave_out_how_the_vehicle_is_built_and_wired(tmp_path: Path) -> None:
    span = {"Range": {"low": "800", "high": "2200"}, "Units": "PWM"}
    built = dict.fromkeys(("SERVO1_MIN", "MOT_PWM_MAX", "RCMAP_ROLL", "INS_ACC2SCAL_X", "SERIAL1_BAUD"), span)
    built["AHRS_ORIENTATION"] = {"Values": {"0": "None", "8": "Roll180"}}
    flown = {"ATC_THR_G_BOOST": span, "SERVO9_FUNCTION": {"Values": {"0": "Disabled"}}}
    (tmp_path / "apm.pdef.json").write_text(json.dumps({"": built | flown}))
    found = binary.BINARIES.inspect(program(tmp_path / "arducopter", b"ArduCopter V4.5.7", BACKEND))
    listing = Listing(binary="0" * 64, parameters={name: Row(1000.0, 9) for name in (*built, *flown)})
    told = {entry.name: entry for entry in describe(found, listing, "").inputs}
    assert {(told[name].low, told[name].choices) for name in built} == {(None, ())}, "known, without a range"
    assert (told["SERVO1_MIN"].unit, told["ATC_THR_G_BOOST"].low) == ("PWM", 800.0)
    assert told["SERVO9_FUNCTION"].low is not None, "our own table has a range for this one"


def test_every_command_offered_is_one_of_the_dialect() -> None:
    assert [name for name in COMMANDS if name not in command_numbers()] == []


def test_describing_loads_no_dialect() -> None:
    """Every simulator process describes every target: what is slow to load must wait for a flight."""
    words = "import sys; from saflite.simulator_worker.targets import ardupilot as a; a.describe(); print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True).stdout.split()
    assert [name for name in said if name.startswith("pymavlink.dialects")] == []


def test_the_description_comes_from_the_binary(tmp_path: Path) -> None:
    found = binary.BINARIES.inspect(program(tmp_path / "arducopter", b"ArduCopter V4.5.7", BACKEND))
    info = describe(found, LISTING, "")
    assert list(own_contradictions(info)) == []
    kinds = {entry.name: (entry.kind, entry.type) for entry in info.inputs}
    assert kinds["RTL_ALT"] == ("parameter", "whole")
    assert kinds["SIM_WIND_SPD"] == ("sensor_fault", "real")
    glitch = next(entry for entry in info.inputs if entry.name == "SIM_GPS_GLITCH_X")
    assert (glitch.low, glitch.high, glitch.unit) == (-0.001, 0.001, "deg"), "a place of its own, not metres as ours"
    assert str(tmp_path) not in repr(info)  # a path is nobody's identity
    assert describe(None, None, "no binary").missing == "no binary"


# ---- inputs -------------------------------------------------------------------------------------------------------


def test_answers_find_their_stimuli(vehicle: Vehicle) -> None:
    stimuli = (
        Stimulus(at_s=0.0, kind="parameter", name="RTL_ALT", values=(900.0,)),
        Stimulus(at_s=0.0, kind="parameter", name="FENCE_ENABLE", values=(9.0,)),
        Stimulus(at_s=0.0, kind="parameter", name="FENCE_TYPE", values=(3.5,)),
        Stimulus(at_s=0.0, kind="command", name="MAV_CMD_NAV_LAND"),
        Stimulus(at_s=0.0, kind="mode", name="LOITER"),
        Stimulus(at_s=0.02, kind="stick", name="RC1", values=(1700.0,)),
    )
    pulses_us = [1500] * 4
    given = Inputs(Client(SimulatedClock(vehicle), Deaf()), pulses_us, stimuli, LISTING, MODE_NUMBERS)
    given.give_due(0.0)
    assert not given.finished
    given.hear(message("PARAM_VALUE", param_id=b"RTL_ALT", param_value=900.0))
    given.hear(message("PARAM_VALUE", param_id=b"FENCE_ENABLE", param_value=0.0))
    given.hear(message("PARAM_VALUE", param_id=b"FENCE_TYPE", param_value=3.0))  # cut to a whole number
    given.hear(message("COMMAND_ACK", command=21, result=0))
    given.give_due(0.02)
    given.give_due(1.5)  # nobody answered the order to change the mode
    assert given.finished
    assert pulses_us[0] == 1700
    answers = [one.answer for one in given.delivered]
    assert answers == ["accepted", "denied", "accepted", "accepted", "timed_out", "accepted"]


# ---- obstacles ----------------------------------------------------------------------------------------------------


def test_sectors_look_forward_first_and_turn_right() -> None:
    ahead = boxes_array([Obstacle(length_m=2, width_m=40, height_m=20, x_m=11, y_m=0)])  # 10 m north
    north = obstacles.distances_cm(ahead, (0.0, 0.0, 5.0), 0.0)
    assert north[0] == 1000
    assert north[36] == obstacles.RANGE_CM + 1
    assert obstacles.distances_cm(ahead, (0.0, 0.0, 5.0), np.pi / 2)[54] == 1000  # nose east: north is to the left
    assert set(obstacles.distances_cm(ahead, (0.0, 0.0, 25.0), 0.0)) == {obstacles.RANGE_CM + 1}  # above it
    assert set(obstacles.distances_cm(boxes_array([]), (0.0, 0.0, 5.0), 0.0)) == {obstacles.RANGE_CM + 1}


def test_turned_boxes_are_seen_where_they_are() -> None:
    turned = boxes_array([Obstacle(length_m=2, width_m=2, height_m=20, x_m=10, y_m=0, rotation_deg=45)])
    assert obstacles.distances_cm(turned, (0.0, 0.0, 5.0), 0.0)[0] == round(100 * (10 - 2**0.5))


# ---- checks -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stimulus", "said"),
    [
        (Stimulus(at_s=0.0, kind="parameter", name="RTL_ATL", values=(1.0,)), "did you mean RTL_ALT?"),
        (Stimulus(at_s=0.0, kind="sensor_fault", name="SIM_NO", values=(1.0,)), "one of the binary's 7"),
        (Stimulus(at_s=0.0, kind="command", name="MAV_CMD_FLY_AWAY"), "MAV_CMD"),
        (Stimulus(at_s=0.0, kind="mode", name="HOVER"), "STABILIZE"),
        (Stimulus(at_s=0.0, kind="stick", name="RC9", values=(1500.0,)), "RC1"),
        (Stimulus(at_s=-1.0, kind="mode", name="LOITER"), "0 or later"),
    ],
)
def test_what_cannot_be_given_is_refused(stimulus: Stimulus, said: str) -> None:
    case = TestCase(target=Target(name="ardupilot"), scenario=Scenario(start=StartState()), stimuli=(stimulus,))
    with pytest.raises(Refused, match="stimulus 0") as caught:
        check_test_case(case, LISTING)
    assert said in str(caught.value)


def test_a_camera_does_not_cost_the_mission() -> None:
    mission = builtin_mission("mission2")
    taken = as_taken(mission)
    assert [item.command for item in mission.items] == [530, 22, 16, 21]
    assert [item.command for item in taken.items] == [112, 22, 16, 21]
    assert taken.items[1:] == mission.items[1:]


def test_a_return_without_a_speed_of_its_own_takes_the_common_one() -> None:
    shown: dict[str, float] = {}
    settings.show(cast(Any, shown), {"RTL_SPEED": 0.0, "WPNAV_SPEED": 700.0})
    assert shown["return_speed_set_mps"] == 7.0
    settings.show(cast(Any, shown), {"RTL_SPEED": 300.0, "WPNAV_SPEED": 700.0})
    assert shown["return_speed_set_mps"] == 3.0


@pytest.mark.parametrize(
    ("row", "limits"),
    [
        ({"Bitmask": {"0": "altitude", "1": "circle", "2": "polygon"}}, (0.0, 7.0)),
        ({"Bitmask": {"0": "all", "2": "compass"}}, (None, None)),
        ({"Bitmask": {str(bit): "x" for bit in range(25)}}, (None, None)),
        ({"Bitmask": {"0": "a"}, "Range": {"low": "2", "high": "3"}}, (2.0, 3.0)),
        ({"Bitmask": ["0"]}, (None, None)),
    ],
)
def test_a_mask_is_a_range_where_every_bit_is_documented(
    tmp_path: Path, row: dict[str, Any], limits: tuple[float | None, float | None]
) -> None:
    (tmp_path / "apm.pdef.json").write_text(json.dumps({"": {"A_MASK": row}}))
    told = documented(tmp_path / "arducopter")["A_MASK"]
    assert (told.low, told.high) == limits
