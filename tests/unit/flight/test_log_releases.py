"""What the releases of the autopilots log differently, and what real logs lack: each log is read as far as it tells."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from log_bytes import ATTITUDE, KINDS, POSITION, ardupilot_flight, dataflash, ulog

from saflite.contract.errors import Refused
from saflite.contract.signals import MODES
from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.files import read_log
from saflite.flight.logs.flight_log import FlightLog
from saflite.flight.logs.ulog import read_ulog_log

Topics = dict[str, list[tuple[str, str]]]
Rows = list[tuple[str, float, tuple[float, ...]]]

BOTH = [("B", "nav_state"), ("B", "arming_state"), ("?", "failsafe")]
LATER_STICKS = [("f", "roll"), ("f", "pitch"), ("f", "yaw"), ("f", "throttle"), ("?", "valid")]
OLDER_STICKS = [("f", "x"), ("f", "y"), ("f", "z"), ("f", "r")]
RELEASES: dict[str, tuple[Topics, Rows]] = {
    "1.8": (
        {
            "vehicle_status": [*BOTH, ("?", "rc_signal_lost"), ("?", "is_rotary_wing")],
            "vehicle_status_flags": [("?", "condition_local_position_valid")],
            "geofence_result": [("?", "geofence_violated")],
            "manual_control_setpoint": OLDER_STICKS,
        },
        [
            ("vehicle_status", 1, (3, 2, 0, 0, 1)),
            ("vehicle_status", 5, (5, 2, 1, 1, 1)),
            ("vehicle_status_flags", 1, (1,)),
            ("vehicle_status_flags", 5, (0,)),
            ("geofence_result", 1, (0,)),
            ("geofence_result", 5, (1,)),
            ("manual_control_setpoint", 1, (0.0, 0.5, 0.5, 0.0)),
        ],
    ),
    "1.13": (
        {
            "vehicle_status": [*BOTH, ("?", "rc_signal_lost"), ("B", "vehicle_type"), ("?", "geofence_violated")],
            "vehicle_status_flags": [("?", "local_position_valid")],
            "manual_control_setpoint": [*OLDER_STICKS, ("?", "valid")],
        },
        [
            ("vehicle_status", 1, (3, 2, 0, 0, 1, 0)),
            ("vehicle_status", 5, (5, 2, 1, 1, 1, 1)),
            ("vehicle_status_flags", 1, (1,)),
            ("vehicle_status_flags", 5, (0,)),
            ("manual_control_setpoint", 1, (0.0, 0.5, 0.5, 0.0, 1)),
            ("manual_control_setpoint", 5, (1.0, 1.0, 1.0, 1.0, 0)),
        ],
    ),
    "1.15": (
        {
            "vehicle_status": [*BOTH, ("B", "vehicle_type")],
            "failsafe_flags": [
                ("?", "local_position_invalid"),
                ("?", "manual_control_signal_lost"),
                ("?", "geofence_breached"),
            ],
            "manual_control_setpoint": LATER_STICKS,
        },
        [
            ("vehicle_status", 1, (3, 2, 0, 1)),
            ("vehicle_status", 5, (5, 2, 1, 1)),
            ("failsafe_flags", 1, (0, 0, 0)),
            ("failsafe_flags", 5, (1, 1, 1)),
            ("manual_control_setpoint", 1, (0.5, 0.0, 0.0, 0.0, 1)),
            ("manual_control_setpoint", 5, (1.0, 1.0, 1.0, 1.0, 0)),
        ],
    ),
}


def placed(seconds: int = 10, climb_mps: float = 0.0) -> Rows:
    return [
        ("vehicle_local_position", 1 + at / 10, (0.0, 0.0, -5.0 - climb_mps * at / 10, 0.0, 0.0, -climb_mps, True))
        for at in range(seconds * 10)
    ]


def px4(tmp_path: Path, topics: Topics, rows: Rows, **more: Any) -> FlightLog:
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog({"vehicle_local_position": POSITION, **topics}, [*placed(), *rows], **more))
    return read_ulog_log(path)


def at(log: FlightLog, name: str, at_s: float) -> float:
    return float(log.trace.array(name)[round((at_s - 1.0) / 0.05)])


@pytest.mark.parametrize("release", RELEASES)
def test_each_release_of_px4_says_its_states_in_its_own_words(release: str, tmp_path: Path) -> None:
    log = px4(tmp_path, *RELEASES[release])
    states = ("failsafe_gps", "failsafe_fence", "failsafe_radio", "rc_present", "mode", "armed")
    assert [at(log, name, 3.0) for name in states] == [0, 0, 0, 1, MODES["AUTO"], 1]
    assert [at(log, name, 7.0) for name in states] == [1, 1, 1, 0, MODES["RTL"], 1]
    assert [at(log, f"rc{number}_pwm", 7.0) for number in range(1, 5)] == [1750, 1500, 1500, 1500], (
        "the last valid ones"
    )


def test_a_field_that_a_log_does_not_have_costs_what_it_tells_and_no_more(tmp_path: Path) -> None:
    topics: Topics = {
        "vehicle_local_position": [*POSITION, ("?", "z_valid")],
        "vehicle_attitude": ATTITUDE,
        "vehicle_angular_velocity": [("f", f"xyz[{axis}]") for axis in range(3)],
        "vehicle_status": [*BOTH, ("B", "vehicle_type"), ("B", "system_type")],
        "mission_result": [("H", "seq_current"), ("H", "seq_total")],
        "vehicle_gps_position": [("B", "satellites_used"), ("B", "fix_type")],
        "manual_control_setpoint": LATER_STICKS,
        "battery_status": [("f", "voltage_v"), ("B", "warning")],
        "vehicle_local_position_setpoint": [("f", "z")],
        "home_position": [("f", "x"), ("f", "y"), ("f", "z"), ("f", "alt")],
        "vehicle_land_detected": [("?", "landed")],
        "vehicle_command": [("H", "command"), ("?", "from_external"), *(("f", f"param{n}") for n in range(1, 8))],
        "failsafe_flags": [("?", "local_position_invalid"), ("?", "manual_control_signal_lost")],
        "vehicle_air_data": [("f", "baro_alt_meter")],
        "vehicle_control_mode": [("?", "flag_control_termination_enabled")],
        "actuator_armed": [("?", "lockdown"), ("?", "force_failsafe")],
        "orbit_status": [("f", "radius")],
    }
    whole = _read_of(topics, tmp_path)
    for topic, fields in topics.items():
        for gone in fields:
            found = _read_of({**topics, topic: [one for one in fields if one != gone]}, tmp_path)
            lost = whole.trace.signals.keys() - found.trace.signals.keys()
            assert len(lost) < len(whole.trace.signals) / 2, f"{topic} without {gone[1]} cost {sorted(lost)}"
    for topic in topics:
        _read_of({name: fields for name, fields in topics.items() if name != topic}, tmp_path)


def _read_of(topics: Topics, tmp_path: Path) -> FlightLog:
    rows: Rows = [(name, 1 + n, tuple(1.0 for _ in fields)) for name, fields in topics.items() for n in range(9)]
    path = tmp_path / "flight.ulg"
    integers = {"B", "H", "?"}
    whole = [
        (
            name,
            at_s,
            tuple(int(one) if code in integers else one for (code, _), one in zip(topics[name], row, strict=True)),
        )
        for name, at_s, row in rows
    ]
    path.write_bytes(ulog(topics, whole, {"MIS_TAKEOFF_ALT": 2.5, "GF_ACTION": 1.0}))
    return read_ulog_log(path)


def test_of_several_batteries_the_first_that_is_connected_counts(tmp_path: Path) -> None:
    fields = [("f", "voltage_v"), ("?", "connected")]
    topics: Topics = {"battery_status": fields, "battery_status#1": fields}
    log = px4(tmp_path, topics, [("battery_status", 2, (0.0, 0)), ("battery_status#1", 2, (15.5, 1))])
    assert at(log, "battery_v", 5.0) == 15.5


def test_a_state_told_long_before_the_log_began_is_its_first_not_a_part_of_the_flight(tmp_path: Path) -> None:
    rows: Rows = [("vehicle_land_detected", 5.0, (0,)), ("vehicle_status", 9000.0, (2, 2, 0))]
    rows += [("vehicle_attitude", 9000 + n / 10, (1.0, 0.0, 0.0, 0.0)) for n in range(100)]
    path = tmp_path / "late.ulg"
    topics: Topics = {"vehicle_land_detected": [("?", "landed")], "vehicle_status": BOTH, "vehicle_attitude": ATTITUDE}
    path.write_bytes(ulog(topics, rows, began_s=9000.0))
    log = read_ulog_log(path)
    assert log.trace.duration_s == pytest.approx(9.9, abs=0.06)
    assert set(log.trace.array("landed")) == {0.0}


def test_a_row_whose_time_is_damaged_does_not_stretch_the_flight(tmp_path: Path) -> None:
    damaged: Rows = [("vehicle_local_position", 9e9, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, True))]
    assert px4(tmp_path, {}, damaged).trace.duration_s == pytest.approx(9.9, abs=0.06)
    rows = [("XKF1", (2**62, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)), ("EV", (2**50, 11))]
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight() + dataflash(KINDS, rows)[len(dataflash(KINDS, [])) :])
    assert read_dataflash_log(path).trace.duration_s == pytest.approx(10.0, abs=0.06)


def in_flight(home: Rows) -> tuple[Topics, Rows]:
    topics: Topics = {
        "vehicle_status": BOTH,
        "vehicle_land_detected": [("?", "landed")],
        "home_position": [("f", "x"), ("f", "y"), ("f", "z")],
    }
    return topics, [("vehicle_status", 1, (3, 2, 0)), ("vehicle_land_detected", 1, (0,)), *home]


def test_a_log_that_begins_in_the_air_counts_from_home(tmp_path: Path) -> None:
    log = px4(tmp_path, *in_flight([("home_position", 1, (30.0, -40.0, 20.0))]))
    assert [at(log, name, 5.0) for name in ("x_m", "y_m", "altitude_m")] == [-30.0, 40.0, 25.0]


def test_a_log_that_begins_in_the_air_and_does_not_tell_home_tells_no_heights(tmp_path: Path) -> None:
    log = px4(tmp_path, *in_flight([]))
    assert not {"x_m", "y_m", "altitude_m"} & log.trace.signals.keys()
    assert "home_position" in log.sources["altitude_m"]


@pytest.mark.parametrize(
    ("kind", "value"), [("vehicle_type", 2), ("vehicle_type", 3), ("system_type", 10), ("is_rotary_wing", 0)]
)
def test_planes_and_rovers_are_not_judged_as_multicopters_are(kind: str, value: int, tmp_path: Path) -> None:
    topics: Topics = {"vehicle_status": [*BOTH, ("B", kind)], "vehicle_attitude": ATTITUDE}
    lean = math.radians(70)
    rows: Rows = [
        ("vehicle_attitude", 1 + n / 10, (math.cos(lean / 2), math.sin(lean / 2), 0.0, 0.0)) for n in range(90)
    ]
    log = px4(tmp_path, topics, [("vehicle_status", 1, (3, 2, 0, value)), *rows])
    assert set(log.trace.array("mode")) == {-1.0}
    assert not {"roll_deg", "pitch_deg"} & log.trace.signals.keys()
    assert set(log.trace.array("armed")) == {1.0}, "what holds of any vehicle is told"


def test_a_vtol_is_told_while_it_hovers(tmp_path: Path) -> None:
    topics: Topics = {"vehicle_status": [*BOTH, ("B", "vehicle_type")], "vehicle_attitude": ATTITUDE}
    quarter = math.radians(80)
    rows: Rows = [
        (
            "vehicle_attitude",
            1 + n / 10,
            (math.cos(quarter / 2), 0.0, math.sin(quarter / 2), 0.0) if 40 <= n < 60 else (1.0, 0.0, 0.0, 0.0),
        )
        for n in range(90)
    ]
    status: Rows = [("vehicle_status", t, (3, 2, 0, kind)) for t, kind in ((1.0, 1), (4.9, 2), (7.1, 1))]
    log = px4(tmp_path, topics, [*status, *rows])
    assert float(abs(log.trace.array("pitch_deg")).max()) < 1.0
    assert [at(log, "mode", t) for t in (3.0, 6.0, 9.0)] == [MODES["AUTO"], -1.0, MODES["AUTO"]]


@pytest.mark.parametrize(
    ("ordered_m", "home_m", "aim_m"), [(510.0, 498.0, 12.0), (math.nan, 498.0, 2.5), (510.0, None, None)]
)
def test_a_take_off_ordered_to_a_height_aims_there(
    ordered_m: float, home_m: float | None, aim_m: float | None, tmp_path: Path
) -> None:
    topics: Topics = {
        "vehicle_status": BOTH,
        "vehicle_command": [("H", "command"), ("?", "from_external"), *(("f", f"param{n}") for n in range(1, 8))],
        "home_position": [("f", "alt")],
    }
    rows: Rows = [
        ("vehicle_command", 0.9, (22, 1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, ordered_m)),
        ("vehicle_status", 1, (17, 2, 0)),
        *([("home_position", 0.5, (home_m,))] if home_m is not None else []),
    ]
    log = px4(tmp_path, topics, rows, parameters={"MIS_TAKEOFF_ALT": 2.5})
    if aim_m is None:
        assert "takeoff_altitude_set_m" not in log.trace.signals
        assert "home_position" in log.sources["takeoff_altitude_set_m"]
    else:
        assert at(log, "takeoff_altitude_set_m", 5.0) == pytest.approx(aim_m)


def test_a_geographic_estimate_takes_the_place_of_a_local_one(tmp_path: Path) -> None:
    rows: Rows = [("vehicle_global_position", 1 + n / 10, (47.0 + n * 1e-6, 8.0, 500.0 + n / 10)) for n in range(100)]
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog({"vehicle_global_position": [("d", "lat"), ("d", "lon"), ("f", "alt")]}, rows))
    log = read_ulog_log(path)
    assert at(log, "x_m", 10.0) == pytest.approx(90e-6 * 111_195, rel=0.01)
    assert at(log, "altitude_m", 10.0) == pytest.approx(9.0, abs=0.01)


def test_sticks_that_never_are_valid_rest_and_a_fence_that_only_warns_never_acts(tmp_path: Path) -> None:
    topics: Topics = {"manual_control_setpoint": LATER_STICKS}
    log = px4(tmp_path, topics, [("manual_control_setpoint", 2, (1.0, 1.0, 1.0, 1.0, 0))], parameters={"GF_ACTION": 1})
    assert {at(log, f"rc{number}_pwm", 5.0) for number in range(1, 5)} == {1500.0}
    assert at(log, "failsafe_fence", 5.0) == 0.0
    acts = px4(tmp_path, topics, [], parameters={"GF_ACTION": 3})
    assert "failsafe_fence" not in acts.trace.signals


def ardupilot(tmp_path: Path, kinds: dict[str, tuple[str, str]], rows: list[tuple[str, tuple[Any, ...]]]) -> FlightLog:
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash({**KINDS, **kinds}, rows))
    return read_dataflash_log(path)


def hovering(height_m: float = 0.0, seconds: int = 20) -> list[tuple[str, tuple[Any, ...]]]:
    return [("XKF1", (1_000_000 + n * 100_000, 0, 0.0, 0.0, -height_m, 0.0, 0.0, 0.0)) for n in range(seconds * 10)]


PARM = {"PARM": ("QNf", "TimeUS,Name,Value")}


@pytest.mark.parametrize(
    ("kinds", "signal"),
    [
        ({"BAT": ("QBf", "TimeUS,Instance,Volt")}, "battery_v"),
        ({"BAT": ("QBf", "TimeUS,Inst,Volt")}, "battery_v"),
        ({"BAT": ("QBf", "TimeUS,I,Volt")}, "battery_v"),
        ({"BARO": ("QBf", "TimeUS,I,Alt")}, "baro_altitude_m"),
        ({"GPS": ("QBB", "TimeUS,I,NSats")}, "gps_satellites"),
    ],
)
def test_of_several_sensors_the_first_counts_by_whatever_name_they_are_counted(
    kinds: dict[str, tuple[str, str]], signal: str, tmp_path: Path
) -> None:
    (kind,) = kinds
    told = [(kind, (1_000_000 + n * 100_000, n % 2, 12 if n % 2 == 0 else 99)) for n in range(100)]
    log = ardupilot(tmp_path, kinds, [*hovering(), *told])
    assert float(abs(log.trace.array(signal)[:100]).max()) <= 12.0


def test_the_receiver_in_use_counts_and_the_core_in_use(tmp_path: Path) -> None:
    kinds = {"GPS": ("QBBBB", "TimeUS,I,Status,NSats,U"), "XKF4": ("QBB", "TimeUS,C,PI")}
    rows: list[tuple[str, tuple[Any, ...]]] = []
    for n in range(100):
        us = 1_000_000 + n * 100_000
        rows += [("GPS", (us, 0, 1, 3, 0)), ("GPS", (us, 1, 3, 17, 1)), ("XKF4", (us, 0, int(n >= 50)))]
        rows += [("XKF1", (us, core, 5.0 * core, 0.0, 0.0, 0.0, 0.0, 0.0)) for core in (0, 1)]
    log = ardupilot(tmp_path, kinds, rows)
    assert (at(log, "gps_ok", 5.0), at(log, "gps_satellites", 5.0)) == (1, 17)
    assert (at(log, "x_m", 3.0), at(log, "x_m", 9.0)) == (0.0, 5.0)


def test_older_and_leaner_logs_are_read_from_the_messages_they_have(tmp_path: Path) -> None:
    kinds = {
        "CURR": ("Qf", "TimeUS,Volt"),
        "POS": ("Qddff", "TimeUS,Lat,Lng,Alt,RelAlt"),
        "AHR2": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
    }
    rows: list[tuple[str, tuple[Any, ...]]] = []
    for n in range(100):
        us = 1_000_000 + n * 100_000
        rows += [("CURR", (us, 11.1)), ("POS", (us, 47.0, 8.0, 500.0, n / 10)), ("AHR2", (us, 7.0, 8.0, 9.0))]
    log = ardupilot(tmp_path, kinds, rows)
    told = ("battery_v", "altitude_m", "roll_deg", "pitch_deg")
    assert [at(log, name, 6.0) for name in told] == pytest.approx([11.1, 5.0, 7.0, 8.0], abs=1e-3)


@pytest.mark.parametrize(
    ("logs_disarmed", "events", "armed"),
    [
        (0, [(1.5, 15), (3.0, 28)], [1, 1]),  # opened by arming, the event of it is lost
        (0, [(15.0, 57)], [0, 1]),  # opened by a refused arming
        (0, [(8.0, 11)], [1, 0]),
        (1, [(5.0, 62)], [0, 0]),  # on the bench
        (1, [(5.0, 10), (16.0, 11)], [0, 0]),
    ],
)
def test_arming_is_told_by_what_only_happens_armed(
    logs_disarmed: int, events: list[tuple[float, int]], armed: list[int], tmp_path: Path
) -> None:
    rows: list[tuple[str, tuple[Any, ...]]] = [("PARM", (1_000_000, b"LOG_DISARMED", float(logs_disarmed)))]
    rows += [("EV", (int(at_s * 1e6), number)) for at_s, number in events]
    log = ardupilot(tmp_path, PARM, [*rows, *hovering()])
    assert [at(log, "armed", t) for t in (2.0, 20.0)] == armed


def test_an_ardupilot_log_that_begins_in_the_air_counts_from_home(tmp_path: Path) -> None:
    kinds = {"ORGN": ("QBdd", "TimeUS,Type,Lat,Lng")}
    ends: list[tuple[str, tuple[Any, ...]]] = [("EV", (18_000_000, 18)), ("EV", (19_000_000, 11))]
    log = ardupilot(tmp_path, kinds, [*hovering(30.0), *ends])
    assert (at(log, "altitude_m", 5.0), at(log, "landed", 5.0), at(log, "taken_off", 5.0)) == (30.0, 0.0, 1.0)
    assert "x_m" not in log.trace.signals
    assert "ORGN" in log.sources["x_m"]
    home: list[tuple[str, tuple[Any, ...]]] = [
        ("ORGN", (1_000_000, 0, 47.0, 8.0)),
        ("ORGN", (1_000_000, 1, 47.0001, 8.0)),
    ]
    assert at(ardupilot(tmp_path, kinds, [*home, *hovering(30.0), *ends]), "x_m", 5.0) == pytest.approx(-11.1, abs=0.1)


def test_other_vehicles_are_told_by_their_parameters_where_the_log_lost_its_first_words(tmp_path: Path) -> None:
    with pytest.raises(Refused, match="AIRSPEED_MIN"):
        ardupilot(tmp_path, PARM, [("PARM", (1_000_000, b"AIRSPEED_MIN", 9.0)), *hovering()])
    with pytest.raises(Refused, match="APM:Plane"):
        ardupilot(tmp_path, {"MSG": ("QZ", "TimeUS,Message")}, [("MSG", (1, b"APM:Plane V3.4")), *hovering()])


def test_a_log_holds_no_truth_to_hold_its_belief_against(tmp_path: Path) -> None:
    from saflite.console.operations.log_judging import judge_file

    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight())
    (verdict,) = judge_file(path, None, ("estimate-true",)).verdicts
    assert (verdict.outcome, "believes to be" in verdict.message) == ("inconclusive", True)


@pytest.mark.parametrize("name", ["FLIGHT.BIN", "flight.Bin", "flight.log", "flight"])
def test_a_log_is_known_by_what_it_begins_with(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(ardupilot_flight())
    assert "x_m" in read_log(tmp_path / name).trace.signals
    (tmp_path / "other").write_text("no log")
    with pytest.raises(Refused, match="no suffix"):
        read_log(tmp_path / "other")


@pytest.mark.parametrize("name", ["empty.ulg", "empty.bin"])
def test_an_empty_log_is_told_as_empty(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    with pytest.raises(Refused, match="an empty file"):
        read_log(tmp_path / name)
