"""Home in logs of real autopilots: distances and heights of settings count from where it was moved to."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from log_bytes import KINDS, POSITION, dataflash, ulog

from saflite.flight.logs.dataflash import read_dataflash_log
from saflite.flight.logs.flight_log import FlightLog
from saflite.flight.logs.ulog import read_ulog_log

ORGN, PARM = ("QBddf", "TimeUS,Type,Lat,Lng,Alt"), ("QNf", "TimeUS,Name,Value")
POS = ("Qddff", "TimeUS,Lat,Lng,Alt,RelHomeAlt")
LAT, LNG, SEA_M = 47.0, 8.0, 500.0
NORTH_30_M = LAT + 30.0 / 111_195.0
Row = tuple[str, tuple[Any, ...]]
SETTINGS = {
    "RTL_ALT": ("rtl_altitude_set_m", 15.0, 0.01),
    "RTL_ALT_FINAL": ("rtl_altitude_final_set_m", 0.0, 0.01),
    "FENCE_ALT_MAX": ("fence_altitude_max_set_m", 100.0, 1.0),
    "LAND_ALT_LOW": ("land_altitude_low_set_m", 10.0, 0.01),
    "CHUTE_ALT_MIN": ("chute_altitude_min_set_m", 10.0, 1.0),
}
PX4_SETTINGS = {
    "RTL_RETURN_ALT": ("rtl_altitude_set_m", 60.0),
    "RTL_DESCEND_ALT": ("rtl_descend_altitude_set_m", 30.0),
    "GF_MAX_VER_DIST": ("fence_altitude_max_set_m", 0.0),
    "MPC_LAND_ALT2": ("land_altitude_low_set_m", 5.0),
}


def at(log: FlightLog, name: str, at_s: float) -> float:
    return float(log.trace.array(name)[round((at_s - 1.0) / 0.05)])


def us(at_s: float) -> int:
    return round(at_s * 1e6)


def ardupilot(tmp_path: Path, moved: list[tuple[float, float, float]], origin_up_m: float = 0.0) -> FlightLog:
    """A log of 20 s from 1 s on, 10 m north of the filter's origin; home as (seconds, latitude, height above sea)."""
    rows: list[Row] = [("ORGN", (us(1.0), 0, LAT, LNG, SEA_M + origin_up_m))]
    rows += [("PARM", (us(1.0), name.encode(), value / unit)) for name, (_, value, unit) in SETTINGS.items()]
    rows += [
        ("XKF1", (us(1 + tenth / 10), 0, 10.0, 0.0, origin_up_m - 0.02 * tenth, 0.0, 0.0, 0.0)) for tenth in range(200)
    ]
    for at_s, lat, sea_m in moved:
        rows += [("ORGN", (us(at_s), 0, LAT, LNG, SEA_M + origin_up_m)), ("ORGN", (us(at_s), 1, lat, LNG, sea_m))]
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash({**KINDS, "ORGN": ORGN, "PARM": PARM}, sorted(rows, key=lambda row: row[1][0])))
    return read_dataflash_log(path)


@pytest.mark.parametrize("origin_up_m", [0.0, -7.0])
def test_a_home_that_is_moved_in_an_ardupilot_log_is_where_things_count_from(
    origin_up_m: float, tmp_path: Path
) -> None:
    log = ardupilot(tmp_path, [(2.0, LAT, SEA_M + 0.3), (10.0, NORTH_30_M, SEA_M + 12.0)], origin_up_m)
    assert [at(log, "home_distance_m", t) for t in (1.0, 5.0, 15.0)] == pytest.approx([10.0, 10.0, 20.0], abs=0.1)
    for signal, value, _ in SETTINGS.values():
        raised = value + 12.0 if value else 0.0
        assert [at(log, signal, t) for t in (5.0, 15.0)] == pytest.approx([value, raised], abs=0.01), signal


def test_an_ardupilot_log_that_does_not_tell_home_counts_from_where_it_begins(tmp_path: Path) -> None:
    log = ardupilot(tmp_path, [])
    assert "home_distance_m" not in log.trace.signals
    assert at(log, "rtl_altitude_set_m", 15.0) == pytest.approx(15.0)


def test_places_of_an_ardupilot_log_without_filter_count_from_home_all_the_same(tmp_path: Path) -> None:
    rows: list[Row] = [("POS", (us(1 + tenth / 10), LAT, LNG, SEA_M, 0.1)) for tenth in range(200)]
    rows += [("ORGN", (us(1.0), 1, LAT, LNG, SEA_M)), ("ORGN", (us(10.0), 1, NORTH_30_M, LNG, SEA_M + 12.0))]
    path = tmp_path / "flight.bin"
    path.write_bytes(dataflash({**KINDS, "ORGN": ORGN, "POS": POS}, sorted(rows, key=lambda row: row[1][0])))
    log = read_dataflash_log(path)
    assert [at(log, "home_distance_m", t) for t in (5.0, 15.0)] == pytest.approx([0.0, 30.0], abs=0.1)


HOME = [("f", "x"), ("f", "y"), ("f", "z"), ("d", "lat"), ("d", "lon"), ("f", "alt"), ("?", "valid_lpos")]
MOVED = [
    ("home_position", 0.5, (0.0, 0.0, 0.0, LAT, LNG, SEA_M, False)),
    ("home_position", 1.0, (100.0, 50.0, 3.0, LAT, LNG, SEA_M, True)),
    ("home_position", 10.0, (130.0, 90.0, -17.0, NORTH_30_M, LNG, SEA_M + 20.0, True)),
]


def test_a_home_that_is_moved_in_a_px4_log_is_where_things_count_from(tmp_path: Path) -> None:
    rows = [
        ("vehicle_local_position", 1 + n / 10, (100.0, 50.0, 3.0 - 0.1 * n, 0.0, 0.0, 1.0, True)) for n in range(200)
    ]
    path = tmp_path / "flight.ulg"
    parameters = {name: value for name, (_, value) in PX4_SETTINGS.items()}
    path.write_bytes(ulog({"vehicle_local_position": POSITION, "home_position": HOME}, [*rows, *MOVED], parameters))
    log = read_ulog_log(path)
    assert [at(log, "home_distance_m", t) for t in (5.0, 15.0)] == pytest.approx([0.0, 50.0], abs=0.01)
    for signal, value in PX4_SETTINGS.values():
        raised = value + 20.0 if value else 0.0
        assert [at(log, signal, t) for t in (5.0, 15.0)] == pytest.approx([value, raised], abs=0.01), signal


def test_an_ordered_height_counts_from_where_home_was_at_take_off(tmp_path: Path) -> None:
    """Ordered 5 m below a home that was moved up by 20 m; that home is moved back later changes no aim."""
    commands = [("H", "command"), ("?", "from_external"), *(("f", f"param{number}") for number in range(1, 8))]
    topics = {
        "vehicle_local_position": POSITION,
        "home_position": HOME,
        "vehicle_status": [("B", "nav_state"), ("B", "arming_state")],
        "vehicle_command": commands,
    }
    rows: list[tuple[str, float, tuple[float, ...]]] = [
        ("vehicle_local_position", 1 + n / 10, (100.0, 50.0, 3.0, 0.0, 0.0, 0.0, True)) for n in range(200)
    ]
    rows += [*MOVED, ("vehicle_command", 12.0, (22, True, *[0.0] * 6, SEA_M + 15.0)), ("vehicle_status", 12.1, (17, 2))]
    rows += [("home_position", 16.0, (100.0, 50.0, 3.0, LAT, LNG, SEA_M, True))]
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(topics, rows, {"MIS_TAKEOFF_ALT": 2.5}))
    log = read_ulog_log(path)
    assert [at(log, "takeoff_altitude_set_m", t) for t in (5.0, 14.0, 18.0)] == pytest.approx([2.5, 15.0, 15.0])


def test_a_px4_log_with_places_on_the_globe_only_counts_from_home_all_the_same(tmp_path: Path) -> None:
    rows = [("vehicle_global_position", 1 + n / 10, (LAT, LNG, SEA_M + n / 10)) for n in range(200)]
    topics = {"vehicle_global_position": [("d", "lat"), ("d", "lon"), ("f", "alt")], "home_position": HOME}
    path = tmp_path / "flight.ulg"
    path.write_bytes(ulog(topics, [*rows, *MOVED], {"RTL_RETURN_ALT": 60.0}))
    log = read_ulog_log(path)
    assert [at(log, "home_distance_m", t) for t in (5.0, 15.0)] == pytest.approx([0.0, 30.0], abs=0.1)
    assert [at(log, "rtl_altitude_set_m", t) for t in (5.0, 15.0)] == pytest.approx([60.0, 80.0], abs=0.01)
