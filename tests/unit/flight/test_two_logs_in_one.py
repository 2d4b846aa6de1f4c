"""Two flights in one file are never taken for one: a clock that starts over, logs put one behind the other."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_bytes import ATTITUDE, KINDS, POSITION, STATUS, dataflash, ulog

from saflite.contract.errors import Refused
from saflite.flight.logs.files import read_log
from saflite.flight.logs.resample import Columns

TOPICS = {"vehicle_local_position": POSITION, "vehicle_status": STATUS, "vehicle_attitude": ATTITUDE}
EXTRACT_HEAD = "t_s,x,y,z,vx,vy,vz,roll_deg,pitch_deg,yaw_deg,nav_state,arming_state,landed\n"


def dataflash_rows(start_us: int = 1_000_000) -> list[tuple[str, tuple[Any, ...]]]:
    rows: list[tuple[str, tuple[Any, ...]]] = [("MODE", (start_us, 2, 2, 1))]
    for tenth in range(200):
        rows.append(("XKF1", (start_us + tenth * 100_000, 0, 0.0, 0.0, -tenth / 10, 0.0, 0.0, -1.0)))
    return rows


def ulog_rows(start_s: float = 5.0) -> list[tuple[str, float, tuple[Any, ...]]]:
    rows: list[tuple[str, float, tuple[Any, ...]]] = [("vehicle_status", start_s, (2, 2))]
    for tenth in range(200):
        at_s = start_s + tenth / 10
        rows += [
            ("vehicle_local_position", at_s, (0.0, 0.0, -tenth / 10, 0.0, 0.0, -1.0, True)),
            ("vehicle_attitude", at_s, (math.cos(0.0), math.sin(0.0), 0.0, 0.0)),
        ]
    return rows


def extract_bytes(times_s: list[float]) -> bytes:
    return (EXTRACT_HEAD + "".join(f"{at},0,0,-10,0,0,0,5,0,0,2,2,0\n" for at in times_s)).encode()


SECONDS = [at / 2 for at in range(60)]
TWO: dict[str, Callable[[], bytes]] = {
    "rows.bin": lambda: dataflash(KINDS, dataflash_rows() + dataflash_rows()),
    "joined.bin": lambda: dataflash(KINDS, dataflash_rows()) + dataflash(KINDS, dataflash_rows()),
    "rows.ulg": lambda: ulog(TOPICS, ulog_rows() + ulog_rows()),
    "joined.ulg": lambda: ulog(TOPICS, ulog_rows()) + ulog(TOPICS, ulog_rows()),
    "later.ulg": lambda: ulog(TOPICS, ulog_rows()) + ulog(TOPICS, ulog_rows(100.0)),
    "5 h later.ulg": lambda: ulog(TOPICS, ulog_rows() + ulog_rows(18_000.0)[:150]),
    "5 h earlier.ulg": lambda: ulog(TOPICS, ulog_rows()[:150] + ulog_rows(18_000.0)),
    "5 h later.bin": lambda: dataflash(KINDS, dataflash_rows() + dataflash_rows(18_000_000_000)[:150]),
    "5 h earlier.bin": lambda: dataflash(KINDS, dataflash_rows()[:150] + dataflash_rows(18_000_000_000)),
    "table.csv": lambda: extract_bytes(SECONDS + SECONDS),
}
ONE: dict[str, Callable[[], bytes]] = {
    "one.bin": lambda: dataflash(KINDS, dataflash_rows()),
    "one.ulg": lambda: ulog(TOPICS, ulog_rows()),
    "one.csv": lambda: extract_bytes(SECONDS),
}


@pytest.mark.parametrize("name", TWO)
def test_two_flights_in_one_file_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(TWO[name]())
    with pytest.raises(Refused, match="judge them one by one"):
        read_log(path)


@pytest.mark.parametrize("name", ONE)
def test_one_flight_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(ONE[name]())
    assert read_log(path).trace.samples > 300


def test_single_rows_of_a_wrong_time_and_rows_a_little_late_are_no_second_flight() -> None:
    times = np.arange(200) / 10
    wrong = times.copy()
    wrong[50], wrong[120] = 500.0, 0.0
    late = times.copy()
    late[1::2] -= 0.5
    for given in (wrong, late):
        Columns().add("x_m", given, times)


@pytest.mark.parametrize("suffix", [".bin", ".ulg"])
def test_single_rows_far_from_all_others_are_damage_and_told(suffix: str, tmp_path: Path) -> None:
    path, far_s = tmp_path / f"flight{suffix}", (90_000.0, 40_000.0, 70_000.0)
    if suffix == ".bin":
        rows = dataflash_rows()
        rows[50:50] = [("XKF1", (round(at * 1e6), 0, 9.0, 9.0, 9.0, 0.0, 0.0, 0.0)) for at in far_s]
        path.write_bytes(dataflash(KINDS, rows))
    else:
        told = ulog_rows()
        told[50:50] = [("vehicle_local_position", at, (9.0, 9.0, 9.0, 0.0, 0.0, 0.0, True)) for at in far_s]
        path.write_bytes(ulog(TOPICS, told))
    log = read_log(path)
    assert log.lost == ("3 messages have a time far from all others",)
    assert log.trace.samples > 300
