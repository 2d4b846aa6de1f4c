"""Pieces of the PX4 adapter that need no autopilot: frames, what a file is, telemetry, modes, settings, checks."""

from __future__ import annotations

import ctypes
import math
import platform
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from external_stand_ins import Deaf
from pymavlink.dialects.v20 import ardupilotmega as dialect

from saflite.contract.errors import Refused
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.autopilots.external.elf import MACHINES
from saflite.flight.autopilots.external.inputs import command_numbers
from saflite.flight.autopilots.external.link import SimulatedClock
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.autopilots.external.telemetry import PREARM
from saflite.flight.autopilots.px4 import binary, modes, settings
from saflite.flight.autopilots.px4.check import check_test_case
from saflite.flight.autopilots.px4.describe import describe
from saflite.flight.autopilots.px4.inputs import COMMANDS, Inputs
from saflite.flight.autopilots.px4.metadata import documented
from saflite.flight.autopilots.px4.places import placed
from saflite.flight.autopilots.px4.signals import trace_names
from saflite.flight.autopilots.px4.telemetry import RADIO, Telemetry
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.logs.settings import PX4 as SHOWN
from saflite.flight.mavlink.client import Client
from saflite.flight.native_library import python_library
from saflite.simulator_worker.agreement import own_contradictions

HOME = (47.3977419, 8.5455938, 488.79)
INT32, REAL32 = 6, 9
LISTING = Listing(
    binary="0" * 64,
    parameters={
        "RTL_RETURN_ALT": Row(60.0, REAL32),
        "GF_ACTION": Row(2.0, INT32),
        "IMU_INTEG_RATE": Row(250.0, INT32),
        "CP_DIST": Row(-1.0, REAL32),
        "RC_FAILS_THR": Row(0.0, INT32),
        "CA_ROTOR0_PX": Row(0.15, REAL32),
        "SENS_BOARD_X_OFF": Row(0.0, REAL32),
    },
)


@pytest.fixture
def vehicle() -> Vehicle:
    return Vehicle(np.zeros((0, 8)), 0.0, 1)


@pytest.fixture
def client(vehicle: Vehicle) -> Client:
    made = Client(SimulatedClock(vehicle), Deaf())
    made.latest["HEARTBEAT"] = message("HEARTBEAT", autopilot=12)
    return made


def message(kind: str, **fields: Any) -> Any:
    """Return a message as it comes from the vehicle: packed and read again."""
    made = dialect.mavlink_map[getattr(dialect, f"MAVLINK_MSG_ID_{kind}")]
    values = [fields.get(name, [0] * 4 if "[" in name else 0) for name in made.fieldnames]
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    return dialect.MAVLink(None).parse_buffer(made(*values).pack(link))[0]


# ---- the simulator's interface ------------------------------------------------------------------------------------


def sent(vehicle: Vehicle, name: str, *flags: int) -> Any:
    """Return the message that the native code packs, read by pymavlink."""
    place = (ctypes.c_double * 3)(*HOME)
    library, frame = python_library(), ctypes.create_string_buffer(280)
    library.px4_connect.argtypes = [ctypes.c_void_p, *[ctypes.c_int] * 3, ctypes.c_void_p, ctypes.c_int]
    library.px4_connect(vehicle.address, -1, -1, 10, place, 0)
    pack = getattr(library, name)
    pack.argtypes = [ctypes.c_void_p, ctypes.c_uint64, *[ctypes.c_int] * len(flags), ctypes.c_char_p]
    count = pack(vehicle.address, 4_000_000, *flags, frame)
    return dialect.MAVLink(None).parse_buffer(frame.raw[:count])[0]


def test_sensors_are_packed_as_mavlink_has_them(vehicle: Vehicle) -> None:
    vehicle.set(acc_z_mps2=-9.75, gyro_x_rps=0.25, compass_y_gauss=0.125, baro_m=11.0)
    told = sent(vehicle, "hil_sensor", 1, 0)
    assert told.get_type() == "HIL_SENSOR"
    assert (told.time_usec, told.id) == (4_000_000, 0)
    assert (told.zacc, told.xgyro, told.ymag) == (-9.75, 0.25, 0.125)
    assert told.abs_pressure == pytest.approx(954.5, abs=0.5)  # the standard atmosphere at 500 m
    assert told.pressure_alt == pytest.approx(HOME[2] + 11.0, abs=1e-3)
    assert told.fields_updated == 0x3F | 0x1A00
    assert sent(vehicle, "hil_sensor", 0, 1).fields_updated == 0x3F | 0x1C0


def test_the_receiver_is_packed_as_mavlink_has_it(vehicle: Vehicle) -> None:
    vehicle.set(gps_north_m=111.19, gps_up_m=20.0, gps_vn_mps=3.0, gps_ve_mps=4.0, gps_satellites=10.0)
    told = sent(vehicle, "hil_gps")
    assert told.lat == pytest.approx((HOME[0] + 0.001) * 1e7, abs=20)
    assert (told.lon, told.alt) == (85455938, 508790)
    assert (told.vel, told.vn, told.ve, told.fix_type, told.satellites_visible) == (500, 300, 400, 3, 10)
    assert told.cog == 65535
    vehicle["gps_satellites"] = 3.0
    assert sent(vehicle, "hil_gps").fix_type == 0


def test_the_radio_is_packed_as_mavlink_has_it(vehicle: Vehicle) -> None:
    vehicle.set_pulses([1500, 1400, 1000, 1600, 1, 2, 3, 4])
    told = sent(vehicle, "hil_radio")
    assert (told.chan1_raw, told.chan2_raw, told.chan4_raw, told.chan8_raw) == (1500, 1400, 1600, 4)
    assert (told.chancount, told.rssi) == (8, 100)


@pytest.mark.parametrize("one", [False, True], ids=["MAVLink 2", "MAVLink 1"])
def test_motor_commands_are_taken_from_whole_messages_only(vehicle: Vehicle, one: bool) -> None:
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    controls = [0.25, 0.5, 1.5, float("nan"), *[0.0] * 12]
    other = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 0, 3).pack(link)
    wanted = dialect.MAVLink_hil_actuator_controls_message(5000, controls, 129, 1).pack(link, force_mavlink1=one)
    data = b"\x01\x02" + other + wanted
    take = python_library().hil_take
    take.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int]
    assert take(vehicle.address, data[:-1], len(data) - 1) == len(data) - len(wanted)
    assert not vehicle.answers
    broken = data[:-1] + bytes([data[-1] ^ 1])
    assert take(vehicle.address, broken, len(broken)) == len(broken)
    assert not vehicle.answers
    assert take(vehicle.address, data, len(data)) == len(data)
    assert vehicle.answers


# ---- the binary ---------------------------------------------------------------------------------------------------

NUMBER = {name: number for number, name in MACHINES.items()}[platform.machine()]


def build(folder: Path, *words: bytes, mode: int = 0o755, start_up: str = "echo") -> Path:
    """Return the program of a build folder as PX4's looks."""
    program, scripts = folder / "bin" / "px4", folder / "etc" / binary.START_UP
    program.parent.mkdir(parents=True)
    (scripts / "airframes").mkdir(parents=True)
    head = b"\x7fELF\x02\x01\x01" + bytes(9) + struct.pack("<HH", 2, NUMBER)
    program.write_bytes(head + bytes(44) + b"\0".join((b"", *words, b"")))
    program.chmod(mode)
    (program.parent / binary.ALIASES).touch()
    (scripts / "rcS").write_text(start_up)
    (scripts / "airframes" / binary.AIRFRAME).touch()
    return program


PX4_WORDS = (b"px4_daemon", b"simulator_mavlink")


def test_a_binary_is_known_by_its_content_and_that_of_its_start_up_files(tmp_path: Path) -> None:
    first, again = (binary.BINARIES.inspect(build(tmp_path / name, *PX4_WORDS)) for name in ("one", "two"))
    assert first.digest == again.digest
    assert binary.BINARIES.inspect(build(tmp_path / "three", *PX4_WORDS, start_up="exit")).digest != first.digest
    assert binary.is_px4(first.path)


def _edited(folder: Path) -> None:
    (folder / "etc" / binary.START_UP / "rcS").write_text("exit")


def _added(folder: Path) -> None:
    (folder / "etc" / "extras.txt").write_text("param set A 1")


def _rebuilt(folder: Path) -> None:
    with (folder / "bin" / "px4").open("ab") as file:
        file.write(b"x")


@pytest.mark.parametrize("change", [_edited, _added, _rebuilt])
def test_a_build_that_changed_since_is_refused(tmp_path: Path, change: Callable[[Path], None]) -> None:
    first = binary.BINARIES.inspect(build(tmp_path, *PX4_WORDS))
    binary.BINARIES.check_same(first)
    change(tmp_path)
    with pytest.raises(Refused, match="got another in its place"):
        binary.BINARIES.check_same(first)


@pytest.mark.parametrize(
    ("words", "lost", "said"),
    [
        ((b"hello",), "", "got a program without PX4's words"),
        ((b"px4_daemon",), "", "expected a build for the simulator with simulator_mavlink"),
        (PX4_WORDS, "etc/init.d-posix/rcS", "leave bin/px4 in its build folder"),
        (PX4_WORDS, "bin/px4-alias.sh", "leave bin/px4 in its build folder"),
    ],
)
def test_what_cannot_fly_is_refused_in_one_line(tmp_path: Path, words: tuple[bytes, ...], lost: str, said: str) -> None:
    program = build(tmp_path, *words)
    if lost:
        (tmp_path / lost).unlink()
    with pytest.raises(Refused, match="autopilot") as caught:
        binary.BINARIES.inspect(program)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


# ---- parameters ---------------------------------------------------------------------------------------------------


def test_the_vehicle_starts_with_what_is_given_by_type_and_only_what_it_knows() -> None:
    plain = settings.start_parameters({"RTL_RETURN_ALT": 30.5}, LISTING, obstacles=True)
    assert plain == {"IMU_INTEG_RATE": 200.0, "RC_FAILS_THR": 950.0, "CP_DIST": 3.0, "RTL_RETURN_ALT": 30.5}
    texts = settings.as_texts({**plain, "GF_ACTION": 1e6}, LISTING.types)
    assert (texts["IMU_INTEG_RATE"], texts["RTL_RETURN_ALT"], texts["GF_ACTION"]) == ("200", "30.5", "1000000")


def test_every_setting_shown_has_its_place_in_the_trace(vehicle: Vehicle) -> None:
    assert {*SHOWN, "fs_throttle_set_pwm", "fs_throttle_enabled"} <= set(vehicle.slots())


def test_metadata_of_the_build_gives_ranges(tmp_path: Path) -> None:
    row = '{"name": "A", "type": "Float", "min": 1, "max": 2.5, "units": "m", "shortDesc": "height"}'
    choice = '{"name": "B", "type": "Int32", "values": [{"value": 3, "description": "x"}]}'
    (tmp_path / "parameters.json").write_text(f'{{"parameters": [{row}, {choice}]}}')
    told = documented(tmp_path / "bin" / "px4")
    assert told["A"] == (1.0, 2.5, "m", "height", ())
    assert told["B"].choices == (3.0,)
    assert documented(tmp_path / "elsewhere" / "bin" / "px4") == {}


def test_every_command_offered_is_one_of_the_dialect() -> None:
    assert [name for name in COMMANDS if name not in command_numbers()] == []


def test_describing_loads_no_dialect() -> None:
    """Every simulator process describes every target: what is slow to load must wait for a flight."""
    words = "import sys; from saflite.simulator_worker.targets import px4 as p; p.describe(); print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, check=True).stdout.split()
    assert [name for name in said if name.startswith("pymavlink.dialects")] == []


def test_the_description_comes_from_the_binary(tmp_path: Path) -> None:
    found = binary.BINARIES.inspect(build(tmp_path, *PX4_WORDS))
    info = describe(found, LISTING, "")
    assert list(own_contradictions(info)) == []
    names = {entry.name for entry in info.inputs if entry.kind == "parameter"}
    assert names == {"RTL_RETURN_ALT", "GF_ACTION", "CP_DIST"}  # not what the adapter sets, nor how it is built
    assert "rtl_altitude_set_m" in info.signals
    assert "hold_altitude_min_set_m" not in info.signals  # this binary has no such parameter
    assert str(tmp_path) not in repr(info)
    assert describe(None, None, "no binary").missing == "no binary"


def test_the_time_it_holds_before_a_failsafes_action_is_a_signal() -> None:
    assert "fs_action_delay_set_s" in trace_names({"COM_FAIL_ACT_T": 7.0})
    assert settings.shown_settings({"COM_FAIL_ACT_T": 7.0})["fs_action_delay_set_s"] == 7.0
    assert "fs_action_delay_set_s" not in trace_names({})


# ---- telemetry and inputs -----------------------------------------------------------------------------------------


def test_modes_have_common_names() -> None:
    assert modes.shown(modes.custom("RTL")) == 6.0
    assert modes.shown(2 << 24 | 4 << 16) == 4.0  # its take-off
    assert modes.shown(9 << 16) == modes.OTHER


def test_what_the_vehicle_says_comes_under_common_names(vehicle: Vehicle, client: Client) -> None:
    told = Telemetry(vehicle, client, LISTING.values, HOME)
    vehicle["armed"] = 1.0  # told with the motor commands
    whole = struct.unpack("<f", struct.pack("<i", 3))[0]
    for one in (
        message("HEARTBEAT", custom_mode=modes.custom("RTL"), system_status=5),
        message("HIGH_LATENCY2", failure_flags=RADIO, custom_mode=modes.custom("LOITER") >> 16),
        message("HIGH_LATENCY2", custom_mode=modes.custom("LOITER") >> 16),  # its causes have not been looked at anew
        message("EXTENDED_SYS_STATE", landed_state=2),
        message("GLOBAL_POSITION_INT", relative_alt=12_500),
        message("LOCAL_POSITION_NED", x=3.0, y=4.0, vz=-1.0),
        message("GPS_RAW_INT", fix_type=3, satellites_visible=10, alt=508_790),
        message("SYS_STATUS", onboard_control_sensors_health=PREARM | 65536 | 8, voltage_battery=16_200),
        message("HOME_POSITION", latitude=473977419, longitude=85455938, q=[1.0, 0.0, 0.0, 0.0]),
        message("PARAM_VALUE", param_id=b"GF_ACTION", param_value=whole, param_type=INT32),
    ):
        told.take(one, 1.0)
    told.tick()
    shown = ("mode", "armed", "landed", "taken_off", "gps_ok", "rc_present", "failsafe_radio", "failsafe_gps")
    assert [vehicle[name] for name in shown] == [5.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0]
    assert vehicle["fence_action_set"] == 1.0  # return, by its own number 3
    assert vehicle["gps_altitude_m"] == pytest.approx(20.0)
    assert told.ready
    vehicle["armed"] = 0.0
    told.take(message("HEARTBEAT", custom_mode=modes.custom("LOITER"), system_status=5), 5.0)
    told.tick()
    later = ("failsafe_radio", "gps_ok", "taken_off")
    assert [vehicle[name] for name in later] == [0.0, 0.0, 0.0]  # a cause not told again, a receiver that fell silent


def test_a_home_that_moves_in_flight_by_itself_or_by_an_order_is_no_climb(vehicle: Vehicle, client: Client) -> None:
    told = Telemetry(vehicle, client, LISTING.values, HOME)
    heights = []
    vehicle["armed"] = 1.0
    for home_mm in (488_000, 489_000, 489_000, 490_100, 520_000):  # corrected on the ground and in flight, then ordered
        told.take(message("GLOBAL_POSITION_INT", alt=510_000, relative_alt=510_000 - home_mm), 1.0)
        heights.append(vehicle["altitude_est_m"])
        told.take(message("EXTENDED_SYS_STATE", landed_state=1 if len(heights) == 1 else 2), 1.0)
    assert heights == pytest.approx([22.0, 21.0, 21.0, 21.0, 21.0])


def test_a_take_off_has_the_height_to_reach_that_was_ordered_above_home(vehicle: Vehicle, client: Client) -> None:
    told = Telemetry(vehicle, client, LISTING.values, HOME)
    told.take(message("GLOBAL_POSITION_INT", alt=490_000, relative_alt=0), 1.0)
    told.tick()
    before = vehicle["takeoff_altitude_set_m"]
    told.take_order(Stimulus(at_s=1.0, kind="command", name="MAV_CMD_NAV_LAND", values=(0.0,) * 6 + (30.0,)))
    told.tick()
    assert vehicle["takeoff_altitude_set_m"] == before
    told.take_order(Stimulus(at_s=2.0, kind="command", name="MAV_CMD_NAV_TAKEOFF", values=(0.0,) * 6 + (30.0,)))
    told.tick()
    assert vehicle["takeoff_altitude_set_m"] == pytest.approx(28.79), "PX4 corrected its home by 1.21 m"


@pytest.mark.parametrize(
    ("name", "given", "sent"),
    [
        ("NAV_TAKEOFF", (0.0,) * 6 + (30.0,), (0.0,) * 4 + (math.nan, math.nan, 518.79)),  # 0, 0 is here
        ("NAV_TAKEOFF", (0.0,) * 4 + (47.0, 0.0, 30.0), (0.0,) * 4 + (47.0, 0.0, 518.79)),
        ("DO_REPOSITION", (-1.0, 1.0), (-1.0, 1.0, 0.0, 0.0, math.nan, math.nan, 488.79)),
        ("DO_REPOSITION", (-1.0, 1.0, 0.0, 0.0, 47.0, 8.0, 20.0), (-1.0, 1.0, 0.0, 0.0, 47.0, 8.0, 508.79)),
        ("DO_SET_HOME", (1.0,), (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 488.79)),
        ("NAV_LAND", (0.0,) * 6 + (30.0,), (0.0,) * 6 + (30.0,)),
        ("DO_CHANGE_ALTITUDE", (30.0, 3.0), (30.0, 3.0)),
    ],
)
def test_places_of_a_test_case_count_from_home(name: str, given: tuple[float, ...], sent: tuple[float, ...]) -> None:
    assert placed(f"MAV_CMD_{name}", given, HOME[2]) == pytest.approx(sent, nan_ok=True)


def test_a_height_that_is_left_open_stays_open() -> None:
    assert math.isnan(placed("MAV_CMD_NAV_TAKEOFF", (0.0,) * 6 + (math.nan,), HOME[2])[6])


def test_what_is_acknowledged_must_be_seen(vehicle: Vehicle, client: Client) -> None:
    stimuli = (
        Stimulus(at_s=0.0, kind="mode", name="RTL"),
        Stimulus(at_s=0.1, kind="sensor_fault", name="motor_off", values=(2.0,)),
        Stimulus(at_s=0.2, kind="sensor_fault", name="gps_offset_north", values=(5.0,)),
        Stimulus(at_s=0.2, kind="sensor_fault", name="radio_loss"),
    )
    vehicle.set(armed=1.0, command_2=0.4)
    given = Inputs(vehicle, client, [1500] * 4, stimuli, LISTING, home_up_m=HOME[2])
    given.give_due(0.0)
    given.hear(message("COMMAND_ACK", command=176, result=0))
    given.give_due(0.1)
    given.hear(message("COMMAND_ACK", command=420, result=0))
    given.give_due(0.2)
    vehicle["mode"] = 6.0
    given.give_due(1.0)
    assert not given.finished
    given.give_due(4.0)
    assert given.finished
    assert [one.answer for one in given.delivered] == ["accepted", "denied", "accepted", "accepted"]
    assert (vehicle["fault_gps_offset_north"], vehicle["rc_silent"]) == (5.0, 1.0)


# ---- checks -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stimulus", "said"),
    [
        (Stimulus(at_s=0.0, kind="parameter", name="RTL_RETURN_ATL", values=(1.0,)), "did you mean RTL_RETURN_ALT?"),
        (Stimulus(at_s=0.0, kind="sensor_fault", name="sonar_off"), "one of gps_loss"),
        (Stimulus(at_s=0.0, kind="sensor_fault", name="motor_off", values=(5.0,)), "0 to 4"),
        (Stimulus(at_s=0.0, kind="sensor_fault", name="baro_noise", values=(99.0,)), "0 to 5 m"),
        (Stimulus(at_s=0.0, kind="mode", name="SPORT"), "STABILIZE, ALT_HOLD"),
    ],
)
def test_stimuli_that_cannot_be_given_are_refused(stimulus: Stimulus, said: str) -> None:
    case = TestCase(target=Target(name="px4"), scenario=Scenario(start=StartState(mode="BRAKE")), stimuli=(stimulus,))
    with pytest.raises(Refused) as caught:
        check_test_case(case, LISTING)
    assert said in str(caught.value)


def test_modes_to_start_in_are_those_it_can_hold() -> None:
    case = TestCase(target=Target(name="px4"), scenario=Scenario(start=StartState(mode="AUTO")))
    with pytest.raises(Refused, match="AUTO needs a mission"):
        check_test_case(case, LISTING)
