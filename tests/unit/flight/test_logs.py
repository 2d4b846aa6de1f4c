"""Logs of real autopilots: minimal files written here, read through pyulog and pymavlink."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import KINDS, POSITION, STATUS, ardupilot_flight, dataflash, message, px4_flight, ulog, ulog_parameter

from saflite.contract.errors import Refused
from saflite.contract.flight import Flight
from saflite.contract.signals import MODES
from saflite.contract.test_case import Obstacle, Scenario, Target, TestCase, identity
from saflite.flight.logs.dataflash import read_dataflash, read_dataflash_log
from saflite.flight.logs.ulog import read_ulog, read_ulog_log
from saflite.oracle.judge import judge


def test_a_px4_log_becomes_a_trace(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(px4_flight())
    trace = read_ulog(path)
    assert trace.duration_s == pytest.approx(20.0, abs=0.06)
    assert trace.array("y_m")[[0, 100, 200]] == pytest.approx([0, 5, 10], abs=1e-4)
    assert set(trace.array("altitude_m")) == {0.0}
    assert trace.array("yaw_deg")[[0, 100, 399]] == pytest.approx([350, 355, 9.95], abs=0.02)
    mode = trace.array("mode")
    assert [mode[50], mode[150], mode[-1]] == [MODES["GUIDED"], MODES["AUTO"], MODES["BRAKE"]]
    assert trace.array("takeoff")[50] == 1.0
    assert [(text.at_s, text.text, text.severity) for text in trace.messages] == [(2.0, "engine failure", "warning")]


def test_a_px4_log_is_judged_against_the_boxes_of_a_test_case(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(px4_flight())
    box = Obstacle(length_m=2, width_m=2, height_m=20, x_m=2.0, y_m=10.0)
    case = TestCase(target=Target(name="px4"), scenario=Scenario(obstacles=(box,)))
    flight = Flight(test_case=identity(case), flight_index=0, ending="completed")
    verdict = judge(case, flight, read_ulog(path), ("min-obstacle-distance",)).verdicts[0]
    assert (verdict.outcome, verdict.points) == ("violated", 1.0)
    assert verdict.robustness == pytest.approx(1.0 - 1.5, abs=1e-4)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "a ULog file"),
        (b"PK\x03\x04 nonsense", "a ULog file"),
        (ulog({"vehicle_status": STATUS}, [("vehicle_status", 1.0, (3, 2))]), "no x_m, y_m, altitude_m"),
        (b"ULog\x01\x12\x35", "ULog|position"),
        (px4_flight()[:200], "ULog|position"),
    ],
)
def test_bad_px4_logs_are_refused(tmp_path: Path, data: bytes, reason: str) -> None:
    path = tmp_path / "bad.ulg"
    path.write_bytes(data)
    with pytest.raises(Refused, match=reason):
        read_ulog(path)


def test_invalid_positions_are_no_positions(tmp_path: Path) -> None:
    rows = [("vehicle_local_position", at / 10, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False)) for at in range(50)]
    path = tmp_path / "invalid.ulg"
    path.write_bytes(ulog({"vehicle_local_position": POSITION}, rows))
    with pytest.raises(Refused, match="no x_m, y_m"):
        read_ulog(path)


def test_a_log_without_position_can_be_told_though_not_judged(tmp_path: Path) -> None:
    rows = [("vehicle_local_position", at / 10, (0.0, 0.0, -2.0, 0.0, 0.0, 0.0, False)) for at in range(50)]
    path = tmp_path / "invalid.ulg"
    path.write_bytes(
        ulog({"vehicle_local_position": POSITION, "vehicle_status": STATUS}, [*rows, ("vehicle_status", 9.0, (3, 2))])
    )
    trace = read_ulog(path, placed=False)
    assert "x_m" not in trace.signals
    assert trace.duration_s == pytest.approx(9.0, abs=0.06)
    path.write_bytes(ulog({"vehicle_local_position": POSITION}, []))
    with pytest.raises(Refused, match="no x_m, y_m"):
        read_ulog(path, placed=False)


def test_an_ardupilot_log_becomes_a_trace(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight())
    trace = read_dataflash(path)
    assert trace.duration_s == pytest.approx(10.0, abs=0.06)
    assert trace.array("x_m")[[0, 100, 199]] == pytest.approx([0, 5, 9.95], abs=1e-3)
    assert trace.array("altitude_m")[100] == pytest.approx(5.0, abs=1e-3)
    assert np.unique(trace.array("armed")) == 1.0
    for name, before, after in (("mode", 4, 6), ("failsafe_radio", 0, 1), ("chute_released", 0, 1)):
        assert (trace.array(name)[90], trace.array(name)[110]) == (before, after)


@pytest.mark.parametrize(
    "data", [b"", b"ULog\x01\x12\x35", dataflash(KINDS, [("MODE", (1, 4, 4, 1))]), b"\xa3\x95\x80"]
)
def test_bad_ardupilot_logs_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "bad.bin"
    path.write_bytes(data)
    with pytest.raises(Refused, match="ArduPilot log"):
        read_dataflash(path)


def test_a_missing_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="PX4 log"):
        read_ulog(tmp_path / "none.ulg")
    with pytest.raises(Refused, match="ArduPilot log"):
        read_dataflash(tmp_path / "none.bin")


def test_settings_orders_and_failsafes_come_from_the_messages_and_parameters_of_px4(tmp_path: Path) -> None:
    status = [*STATUS, ("B", "failsafe"), ("B", "vehicle_type")]
    topics = {
        "vehicle_status": status,
        "failsafe_flags": [("?", "local_position_invalid"), ("?", "manual_control_signal_lost")],
        "vehicle_land_detected": [("?", "landed")],
        "battery_status": [("f", "voltage_v"), ("B", "warning")],
    }
    rows: list[tuple[str, float, tuple[float, ...]]] = [
        ("vehicle_status", 1.0, (2, 1, 0, 1)),
        ("vehicle_status", 3.0, (2, 2, 0, 1)),
        ("vehicle_status", 8.0, (5, 2, 1, 1)),
        ("vehicle_status", 10.0, (5, 2, 1, 2)),
        ("failsafe_flags", 1.0, (True, False)),
        ("failsafe_flags", 4.0, (False, False)),
        ("failsafe_flags", 7.0, (True, True)),
        ("vehicle_land_detected", 1.0, (True,)),
        ("vehicle_land_detected", 5.0, (False,)),
        ("battery_status", 1.0, (16.0, 0)),
        ("battery_status", 9.0, (14.0, 1)),
        ("vehicle_land_detected", 11.0, (False,)),
    ]
    whole = ulog(topics, rows)
    head = whole.index(message("F", b"vehicle_status")[3:]) - 3
    path = tmp_path / "flight.ulg"
    path.write_bytes(whole[:head] + ulog_parameter("RTL_RETURN_ALT", 60.0) + whole[head:])
    log = read_ulog_log(path)

    def at(name: str, at_s: float) -> float:
        return float(log.trace.array(name)[round((at_s - 1.0) / 0.05) + 1])

    assert at("rtl_altitude_set_m", 2.0) == 60.0
    assert [at("failsafe_gps", t) for t in (2, 5, 8)] == [0, 0, 1], "what never was there is not lost"
    assert [at("failsafe_radio", t) for t in (5, 7.5, 9)] == [0, 0, 1], "a link that nobody asks for raises nothing"
    assert [at("rc_present", t) for t in (5, 8)] == [1, 0]
    assert [at("taken_off", t) for t in (2, 4, 6)] == [0, 0, 1]
    assert [at("failsafe_battery", t) for t in (5, 10)] == [0, 1]
    assert at("mode", 10.5) == -1.0, "flown as a plane"
    assert log.sources["rtl_altitude_set_m"] == "parameter RTL_RETURN_ALT"


def test_parameters_and_their_changes_in_an_ardupilot_log_are_settings_and_inputs(tmp_path: Path) -> None:
    kinds = {**KINDS, "PARM": ("QNf", "TimeUS,Name,Value")}
    start: list[tuple[str, tuple[Any, ...]]] = [
        ("PARM", (1, b"RTL_ALT", 1500.0)),
        ("PARM", (1, b"STAT_RUNTIME", 1.0)),
    ]
    later: list[tuple[str, tuple[Any, ...]]] = [
        ("PARM", (6_000_000, b"RTL_ALT", 3000.0)),
        ("PARM", (6_000_000, b"STAT_RUNTIME", 2.0)),
    ]
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(kinds, start) + ardupilot_rows(kinds) + dataflash(kinds, later)[-2 * 31 :])
    log = read_dataflash_log(path)
    heights = log.trace.array("rtl_altitude_set_m")
    assert (heights[10], heights[150]) == (15.0, 30.0)
    assert [(one.name, one.values, round(one.at_s, 2)) for one in log.stimuli] == [("RTL_ALT", (3000.0,), 5.0)]
    assert log.trace.array("chute_released").max() == 1.0


def ardupilot_rows(kinds: dict[str, tuple[str, str]]) -> bytes:
    return ardupilot_flight(kinds)[len(dataflash(kinds, [])) :]


def test_a_crash_that_the_autopilot_logged_is_a_crash(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight() + dataflash(KINDS, [("ERR", (10_900_000, 12, 1))])[len(dataflash(KINDS, [])) :])
    assert read_dataflash_log(path).crashed


def test_the_log_of_a_plane_is_refused(tmp_path: Path) -> None:
    kinds = {**KINDS, "MSG": ("QZ", "TimeUS,Message")}
    path = tmp_path / "plane.bin"
    said: list[tuple[str, tuple[Any, ...]]] = [("MSG", (1, b"ArduPlane V4.5.0"))]
    path.write_bytes(dataflash(kinds, said) + ardupilot_rows(kinds))
    with pytest.raises(Refused, match="ArduPlane"):
        read_dataflash_log(path)


def test_a_log_of_another_autopilot_in_the_format_of_px4_is_refused_by_what_it_holds(tmp_path: Path) -> None:
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog({"PathPlanner": [("f", "speed")]}, [("PathPlanner", 1.0, (0.5,))]))
    with pytest.raises(Refused, match="messages of PX4's flights, got PathPlanner"):
        read_ulog_log(path)


@pytest.mark.parametrize(
    "formats",
    [
        [*(f"x{i}:x{i + 1}[100] a;" for i in range(6)), "x6:float a;", "x:uint64_t timestamp;x0 a;"],
        ["x:uint64_t timestamp;" + "".join(f"float[65535] a{i};" for i in range(500))],
        ["x:uint64_t timestamp;x a;"],
        [*(f"x{i}:x{i + 1} a;" for i in range(500)), "x500:float a;", "x:uint64_t timestamp;x0 a;"],
    ],
)
def test_formats_that_unfold_without_end_are_refused_at_once(formats: list[str], tmp_path: Path) -> None:
    head = px4_flight()[:16] + message("B", b"\0" * 40)
    told = b"".join(message("F", text.encode()) for text in formats)
    (tmp_path / "a.ulg").write_bytes(head + told + message("A", b"\0\0\0x") + message("D", b"\0" * 100))
    began_s = time.process_time()
    with pytest.raises(Refused, match="PX4 log"):
        read_ulog(tmp_path / "a.ulg", placed=False)
    assert time.process_time() - began_s < 5.0, "measured: 0.1 s"


@pytest.mark.parametrize("length", [0, 1, 2])
def test_dataflash_messages_without_length_are_not_read_for_ever(length: int, tmp_path: Path) -> None:
    described = [(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"), (1, length, b"EMP", b"", b"")]
    head = b"".join(b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *one) for one in described)
    (tmp_path / "a.bin").write_bytes(head + b"\xa3\x95\x01" * 100)
    with pytest.raises(Refused, match="expected a position"):
        read_dataflash(tmp_path / "a.bin")
