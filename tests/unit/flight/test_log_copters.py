"""What ArduCopter up to 3.5 and from 4.7 on logs otherwise: names, units, rows without a time, filters that rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import KINDS, ardupilot_flight, dataflash

from saflite.console.operations.log_judging import judge_file
from saflite.contract.errors import Refused
from saflite.contract.signals import MODES
from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.flight_log import FlightLog
from saflite.flight.logs.settings import ARDUPILOT

OLD = {
    "PARM": ("Nf", "Name,Value"),
    "MODE": ("Mh", "Mode,ThrCrs"),
    "EV": ("B", "Id"),
    "ATT": ("Ifff", "TimeMS,Roll,Pitch,Yaw"),
    "EKF1": ("Iffffff", "TimeMS,PN,PE,PD,VN,VE,VD"),
    "CTUN": ("Ihfhf", "TimeMS,ThrOut,Alt,CRt,DAlt"),
    "CURR": ("Ihh", "TimeMS,Volt,Curr"),
    "BARO": ("If", "TimeMS,Alt"),
}
PLACED = {**KINDS, "PARM": ("QNf", "TimeUS,Name,Value"), "POS": ("Qddf", "TimeUS,Lat,Lng,RelHomeAlt")}
NAMES: list[tuple[str, float, dict[str, float]]] = [
    ("rtl_altitude_set_m", 15.0, {"RTL_ALT_M": 15.0, "RTL_ALT": 1500.0}),
    ("rtl_altitude_final_set_m", 2.0, {"RTL_ALT_FINAL_M": 2.0, "RTL_ALT_FINAL": 200.0}),
    ("return_climb_min_set_m", 3.0, {"RTL_CLIMB_MIN_M": 3.0, "RTL_CLIMB_MIN": 300.0}),
    ("return_speed_set_mps", 4.0, {"RTL_SPEED_MS": 4.0, "RTL_SPEED": 400.0}),
    ("cruise_speed_set_mps", 5.0, {"WP_SPD": 5.0, "WPNAV_SPEED": 500.0}),
    ("descent_speed_set_mps", 1.5, {"WP_SPD_DN": 1.5, "WPNAV_SPEED_DN": 150.0}),
    ("takeoff_speed_set_mps", 2.5, {"WP_SPD_UP": 2.5, "WPNAV_SPEED_UP": 250.0}),
    ("acceleration_set_mps2", 1.0, {"WP_ACC": 1.0, "WPNAV_ACCEL": 100.0}),
    ("waypoint_radius_set_m", 2.0, {"WP_RADIUS_M": 2.0, "WPNAV_RADIUS": 200.0}),
    ("loiter_speed_set_mps", 12.5, {"LOIT_SPEED_MS": 12.5, "LOIT_SPEED": 1250.0, "WPNAV_LOIT_SPEED": 1250.0}),
    ("land_speed_set_mps", 0.5, {"LAND_SPD_MS": 0.5, "LAND_SPEED": 50.0}),
    ("land_speed_high_set_mps", 1.0, {"LAND_SPD_HIGH_MS": 1.0, "LAND_SPEED_HIGH": 100.0}),
    ("land_altitude_low_set_m", 10.0, {"LAND_ALT_LOW_M": 10.0, "LAND_ALT_LOW": 1000.0}),
    ("pilot_speed_up_set_mps", 2.5, {"PILOT_SPD_UP": 2.5, "PILOT_SPEED_UP": 250.0, "PILOT_VELZ_MAX": 250.0}),
    ("pilot_speed_down_set_mps", 1.5, {"PILOT_SPD_DN": 1.5, "PILOT_SPEED_DN": 150.0, "PILOT_VELZ_MAX": 150.0}),
    ("pilot_takeoff_set_m", 1.0, {"PILOT_TKO_ALT_M": 1.0, "PILOT_TKOFF_ALT": 100.0}),
    ("yaw_slew_set_dps", 60.0, {"ATC_RATE_WPY_MAX": 60.0, "ATC_SLEW_YAW": 6000.0}),
    ("angle_max_set_deg", 30.0, {"ATC_ANGLE_MAX": 30.0, "ANGLE_MAX": 3000.0}),
    ("circle_radius_set_m", 10.0, {"CIRCLE_RADIUS_M": 10.0, "CIRCLE_RADIUS": 1000.0}),
    ("battery_low_set_v", 10.5, {"BATT_LOW_VOLT": 10.5, "FS_BATT_VOLTAGE": 10.5}),
    ("battery_low_charge_set_mah", 600.0, {"BATT_LOW_MAH": 600.0, "FS_BATT_MAH": 600.0}),
    ("battery_low_action_set", 2.0, {"BATT_FS_LOW_ACT": 2.0, "FS_BATT_ENABLE": 2.0}),
]


def write(path: Path, kinds: dict[str, tuple[str, str]], rows: Sequence[tuple[str, tuple[Any, ...]]]) -> FlightLog:
    path.write_bytes(dataflash(kinds, rows))
    return read_dataflash_log(path)


@pytest.mark.parametrize(("signal", "value", "names"), NAMES, ids=[signal for signal, _, _ in NAMES])
def test_a_setting_is_the_same_under_the_name_and_in_the_unit_of_each_release(
    signal: str, value: float, names: dict[str, float]
) -> None:
    for name, told in names.items():
        assert ARDUPILOT[signal]({name: told}) == pytest.approx(value), name


def test_up_to_35_a_battery_had_one_limit_and_ten_seconds() -> None:
    given = {"FS_BATT_VOLTAGE": 10.5}
    assert [ARDUPILOT[name](given) for name in ("battery_critical_set_v", "battery_timer_set_s")] == [0.0, 10.0]


def test_checks_that_are_skipped_say_which_are_made_where_that_is_all_or_none() -> None:
    checks = ARDUPILOT["arming_checks_set"]
    assert [checks({"ARMING_SKIPCHK": skipped}) for skipped in (0.0, -1.0)] == [1.0, 0.0]
    assert math.isnan(checks({"ARMING_SKIPCHK": 4.0}))


def test_up_to_33_what_flew_without_a_filter_went_by_the_barometer() -> None:
    source = ARDUPILOT["altitude_source"]
    assert source({"AHRS_EKF_USE": 0.0}) == 0.0
    assert source({"AHRS_EKF_USE": 0.0, "AHRS_EKF_TYPE": 3.0, "EK3_SRC1_POSZ": 3.0}) == 2.0
    with pytest.raises(StopIteration):
        source({"AHRS_EKF_USE": 1.0})


def test_where_precision_landing_is_on_nothing_is_said_of_the_speed_of_a_landing() -> None:
    speed = ARDUPILOT["land_speed_set_mps"]
    assert speed({"LAND_SPEED": 50.0, "PLND_ENABLED": 0.0}) == 0.5
    assert math.isnan(speed({"LAND_SPEED": 50.0, "PLND_ENABLED": 1.0}))


def old_flight(**settings: float) -> list[tuple[str, tuple[Any, ...]]]:
    """A log as 3.2 wrote it, from 60 s after power-up on: hovers 3 m up in ALT_HOLD while its filter runs away."""
    rows: list[tuple[str, tuple[Any, ...]]] = [("PARM", (name.encode(), value)) for name, value in settings.items()]
    rows += [("MODE", (2, 500)), ("EV", (10,)), ("EV", (28,))]
    for tenth in range(100):
        at = 60_000 + tenth * 100
        rows += [("ATT", (at, 1.0, 2.0, 3.0)), ("EKF1", (at, 0.0, 0.0, 90.0 * tenth, 0.0, 0.0, 900.0))]
        rows += [("CTUN", (at, 450, 3.0, 0, 3.0)), ("CURR", (at, 1187, 0)), ("BARO", (at, 3.0))]
    return rows


def test_a_log_of_32_is_read_in_its_own_words_units_and_time(tmp_path: Path) -> None:
    log = write(tmp_path / "flight.bin", OLD, old_flight(AHRS_EKF_USE=0.0))
    assert log.trace.duration_s == pytest.approx(9.9, abs=0.1), "rows before the clock runs are no minute of flight"
    middle = {name: float(log.trace.array(name)[100]) for name in ("mode", "armed", "throttle", "battery_v")}
    assert middle == pytest.approx({"mode": MODES["ALT_HOLD"], "armed": 1.0, "throttle": 0.45, "battery_v": 11.87})
    assert not log.lost


def test_the_estimate_is_that_of_what_flies_not_of_a_filter_that_runs_along(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    apart = {
        use: float(np.ptp(write(path, OLD, old_flight(AHRS_EKF_USE=use)).trace.array("altitude_m")))
        for use in (0.0, 1.0)
    }
    assert apart[0.0] < 0.1
    assert apart[1.0] > 8000.0


@pytest.mark.parametrize(("kind", "north_m"), [(0, 20.0), (3, 10.0), (10, 20.0), (11, 20.0)])
def test_places_are_those_that_the_autopilot_flies_by(kind: int, north_m: float, tmp_path: Path) -> None:
    at = [1_000_000 + tenth * 100_000 for tenth in range(101)]
    more = [("PARM", (1_000_000, b"AHRS_EKF_TYPE", float(kind)))]
    more += [("POS", (now, 47.0 + 20.0 * n / 100 / 111_319.5, 8.0, 5.0)) for n, now in enumerate(at)]  # type: ignore[misc]
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight(PLACED, more=more))  # type: ignore[arg-type]
    assert read_dataflash_log(path).trace.array("x_m")[-1] == pytest.approx(north_m, abs=0.2)


@pytest.mark.parametrize("barometer", ["BarAlt", "BAlt", ""])
def test_what_stands_while_its_estimate_settles_is_on_the_ground_by_the_barometer_of_any_message(
    barometer: str, tmp_path: Path
) -> None:
    kinds = {**OLD, "CTUN": ("Ihfhff", f"TimeMS,ThrOut,Alt,CRt,DAlt,{barometer or 'Other'}")}
    del kinds["BARO"]
    rows: list[tuple[str, tuple[Any, ...]]] = [("PARM", (b"CHUTE_ENABLED", 0.0)), ("MODE", (0, 500)), ("EV", (10,))]
    for tenth in range(200):
        at, settled = 60_000 + tenth * 100, 1.0 - math.exp(-tenth / 10)
        up_m = max(0.0, 0.1 * (tenth - 100))
        rows += [("CTUN", (at, 0, 5.0 * settled - 5.0 + up_m, 0, 0.0, up_m)), ("ATT", (at, 0.0, 0.0, 0.0))]
        rows += [("EV", (28,))] if tenth == 100 else []
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(kinds, rows))
    (verdict,) = judge_file(path, None, ("landed-on-ground",)).verdicts
    assert verdict.outcome == ("held" if barometer else "violated"), verdict.message
    trace = read_dataflash_log(path, placed=False).trace
    assert ("baro_altitude_m" in trace.signals) == bool(barometer)


def test_where_no_filter_flies_the_climb_is_that_of_the_control_of_height(tmp_path: Path) -> None:
    kinds = {**PLACED, "CTUN": ("Qfh", "TimeUS,Alt,CRt")}
    more = [("PARM", (1_000_000, b"AHRS_EKF_TYPE", 0.0))]
    more += [("POS", (1_000_000 + n * 100_000, 47.0, 8.0, 5.0 + 0.2 * n)) for n in range(101)]  # type: ignore[misc]
    more += [("CTUN", (1_000_000 + n * 100_000, 0.0, 200)) for n in range(101)]  # type: ignore[misc]
    path = tmp_path / "flight.bin"
    path.write_bytes(ardupilot_flight(kinds, more=more))  # type: ignore[arg-type]
    trace = read_dataflash_log(path).trace
    assert (trace.array("altitude_m")[-1], trace.array("climb_mps")[-1]) == pytest.approx((20.0, 2.0), abs=0.01)


@pytest.mark.parametrize(("pulse", "outcome"), [(1046, "vacuous"), (950, "violated")])
def test_a_limit_of_the_throttle_is_on_the_calibrated_way_of_its_stick(
    pulse: int, outcome: str, tmp_path: Path
) -> None:
    kinds = {**PLACED, "RCIN": ("QHHHH", "TimeUS,C1,C2,C3,C4")}
    settings = {"RC3_MIN": 1090, "RC3_MAX": 1900, "FS_THR_VALUE": 1000, "FS_THR_ENABLE": 1}
    rows: list[tuple[str, tuple[Any, ...]]] = [("PARM", (1, name.encode(), one)) for name, one in settings.items()]
    rows += [("MODE", (1_000_000, 0, 0, 1)), ("EV", (1_000_000, 10)), ("EV", (1_100_000, 28))]
    for tenth in range(200):
        now = 1_000_000 + tenth * 100_000
        rows += [("XKF1", (now, 0, 0.0, 0.0, -9.0, 0.0, 0.0, 0.0))]
        rows += [("RCIN", (now, 1500, 1500, pulse if tenth > 80 else 1500, 1500))]
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash(kinds, rows))
    (verdict,) = judge_file(path, None, ("a-rc-fs2",)).verdicts
    assert verdict.outcome == outcome


def test_a_copter_of_47_is_none_of_the_others(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    names = ("AIRSPEED_MIN", "RTL_ALT_M")
    rows = [("PARM", (1_000_000, name.encode(), 15.0)) for name in names]
    path.write_bytes(ardupilot_flight(PLACED, more=rows))  # type: ignore[arg-type]
    read_dataflash_log(path)
    path.write_bytes(ardupilot_flight(PLACED, more=rows[:1]))  # type: ignore[arg-type]
    with pytest.raises(Refused, match="AIRSPEED_MIN"):
        read_dataflash_log(path)


def test_a_parachute_whose_release_is_not_among_the_events_is_in_whatever_was_set(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    places = [("XKF1", (at, 0, 0.0, 0.0, -5.0, 0.0, 0.0, 0.0)) for at in range(1_000_000, 5_000_000, 100_000)]
    for told, known in (([("EV", (1_000_000, 10))], True), ([], False)):
        path.write_bytes(dataflash(KINDS, [*told, *places]))  # no parameters: they may be lost, or left out
        trace = read_dataflash_log(path).trace
        assert ("chute_released" in trace.signals) == known
        assert not known or trace.array("chute_released").max() == 0.0
